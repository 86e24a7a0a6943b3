"""How Sphinx makes the site: `make docs`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils.nodes import Element, Text, TextElement
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.ext.intersphinx import missing_reference
from sphinx.util.inspect import stringify_signature

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

from hyperparameters import tables as tables_of_keys  # noqa: E402
from mend import with_lines_of_arguments, with_links_back, without_empty_headers  # noqa: E402
from signatures import ranges_in_words, signature_of  # noqa: E402
from tables import keep_together  # noqa: E402

import uavrl  # noqa: E402

project = "uavrl"
author = copyright = "the uavrl authors"
version = release = uavrl.__version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "myst_nb",
]
_OURS = ["conf.py", "hyperparameters.py", "mend.py", "signatures.py", "tables.py", "tutorials/shell.py"]
exclude_patterns = ["_build", "figures", *_OURS]
nitpicky = True
suppress_warnings = ["myst-nb.lexer"]  # of tutorials that are shown without being run

html_theme = "furo"
html_title = "uavrl"
html_static_path = ["_static"]
templates_path = ["_templates"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_show_sphinx = False

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "dollarmath", "substitution"]
myst_substitutions = {"ranges": ranges_in_words(), **tables_of_keys()}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# Tutorials are scripts in jupytext's percent format; what they print and draw is kept until they change.
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"
nb_execution_timeout = 1800
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"

autodoc_default_options = {"members": True, "show-inheritance": True, "member-order": "groupwise"}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_inherit_docstrings = False  # TorchRL's speak of what our pages do not have
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_use_rtype = False

# Addresses of foreign names, from files: the site is built without a network.
_FOREIGN = {
    "python": "https://docs.python.org/3.11",
    "torch": "https://docs.pytorch.org/docs/stable",
    "tensordict": "https://docs.pytorch.org/tensordict/0.14",
    "torchrl": "https://docs.pytorch.org/rl/0.14",
}
intersphinx_mapping = {name: (address, f"_inventories/{name}.txt") for name, address in _FOREIGN.items()}

# Packages without an inventory here, what is private, and pieces of types that Sphinx cuts in two.
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|omegaconf|gymnasium|zipfile|tensordict\._nestedkey)\b.*|torchrl\..*\.MultiStepTransform"),
    (
        r"py:.*",
        r".*\._(AcceptedKeys|ClassHistory)|uavrl\.config\.validation\.T|uavrl\.config\.settings\.(TrainerConfig|FlyingConfig)|uavrl\.config\.parts\.Part",
    ),
    (r"py:.*", r"uavrl\.reporting\.(runs\.LeftOut|learning_curves\.curves)|uavrl\.runs\.episodes\.Episode"),
    (r"py:.*", r"uavrl\.(shown\.Shown|training\.compiled\.LossGradients)|stable_baselines3\..*"),
    (
        r"py:.*",
        r"uavrl_onboard\.(ros2\.dds|autopilot\.firmware|flight\.(limits|health)|lidar\.scans\.Skipped|mesh|policy\.contract_parts)(\.\w+)?|Contract|FirmwareName|GuardTerms|LiveEpisode|Motion|MotionTerms|MemoryTerms|Network|Vector",
    ),
    (
        r"py:.*",
        r"uavrl\.envs\.(traps\.Trap|terrain\.HeightField|rules\.Standing|difficulty\.Difficulty|file_worlds\.FileWorld|shape_file\.Surface|ray_patterns\.SensorRays|sensors\.SENSORS|mapped_way)|Trap|HeightField|Standing|Difficulty|FileWorld|Mesh",
    ),
    (
        r"py:.*",
        r"uavrl\.(evaluation\.interventions|training\.validation\.(Validated|Flier)|reporting\.groups\.Group|models\.memory\.GRUMemory|losses\.(xqc\._Categorical|crossq\._WithoutTargets))|Flier",
    ),
    (r"py:.*", r"uavrl_onboard\.perception\.motion\.(rays\.ScanPattern|occlusion\.Returns)"),
    (r"py:.*", r"torchrl\.(objectives\.CrossQLoss|modules\.BatchRenorm1d|data\.SliceSampler)"),
    (r"py:.*", r"torch\.nn\.modules\.linear\.Linear|collections\.abc\.Collection"),
    (r"py:.*", r"Path|np\.ndarray|torchrl\..*\.TransformedEnv"),
    (r"py:.*", r"Tensor|TensorDictBase|uavrl\.envs\.(mesh\.Mesh|simulation\.Simulation|tasks\.Task|traffic\.Traffic)"),
    (r"py:.*", r"(typing\.|collections\.abc\.)?(Annotated|Literal|Mapping|tuple|dict)\[[^\]]*"),
]

# Pages at the root of the repository, which the site has under the names of docs/.
_ROOT_PAGES = {
    "CHANGELOG.md": "changelog.md",
    "CODE_OF_CONDUCT.md": "code_of_conduct.md",
    "CONTRIBUTING.md": "contributing.md",
    "README.md": "index.md",
    "SECURITY.md": "security.md",
}


def _stay_on_the_site(app: Sphinx, docname: str, source: list[str]) -> None:
    """Turns links from docs/ to the pages of the root into links to their pages here."""
    for name, page in _ROOT_PAGES.items():
        source[0] = re.sub(rf"\]\(((?:\.\./)*)\.\./{re.escape(name)}", rf"](\1{page}", source[0])


def _stay_on_the_site_too(app: Sphinx, path: Path, parent: str, source: list[str]) -> None:
    """The same for links among the pages of the root."""
    for name, page in _ROOT_PAGES.items():
        source[0] = source[0].replace(f"]({name}", f"](docs/{page}")


def _find_where_public(app: Sphinx, env: BuildEnvironment, node: Element, text: TextElement) -> Element | None:
    """Finds a class under its public name: ``torch.nn.modules.module.Module`` is ``torch.nn.Module``."""
    *modules, name = str(node.get("reftarget", "")).split(".")
    if node.get("refdomain") != "py":
        return None
    for length in range(len(modules) - 1, 0, -1):
        node["reftarget"] = ".".join([*modules[:length], name])
        for known, _ in env.domains.python_domain.find_obj(env, "", "", node["reftarget"], None):
            return env.domains.python_domain.resolve_xref(
                env, node["refdoc"], app.builder, node["reftype"], known, node, text
            )
        if found := missing_reference(app, env, node, text):
            return found
    here = env.domains.python_domain.find_obj(env, "", "", name, None, searchmode=1)
    if here and not modules:
        node["reftarget"] = here[0][0]
        return env.domains.python_domain.resolve_xref(
            env, node["refdoc"], app.builder, node["reftype"], here[0][0], node, text
        )
    return None


def _show_own_arguments(
    app: Sphinx, what: str, name: str, thing: Any, options: object, arguments: str | None, returned: str | None
) -> tuple[str, str | None] | None:
    """Shows a constructor's own arguments where a metaclass hides them, and ranges in words."""
    if arguments is None or not re.search(r"^\(\*args|\bAnnotated\[|<(factory|function)|= lambda\b", arguments):
        return None
    signature = signature_of(thing, bound=what == "method")
    # Quoted once for Sphinx, which drops a pair, and once so that what it hands on is Python.
    quoted = [
        each.replace(annotation=f"'{each.annotation!r}'") if isinstance(each.annotation, str) else each
        for each in signature.parameters.values()
    ]
    signature = signature.replace(parameters=quoted, return_annotation=signature.empty)
    return stringify_signature(signature, unqualified_typehints=True), returned


def _drop_quotes_of_ranges(app: Sphinx, domain: str, kind: str, content: Element) -> None:
    """Shows ``float > 0`` for ``'float > 0'``: a type in quotes alone is one of ours in words."""
    for node in list(content.parent.findall(addnodes.desc_sig_literal_string)):
        if isinstance(node.parent, addnodes.desc_sig_name) and len(node.parent) == 1:
            node.parent.replace(node, Text(node.astext().strip("'")))


def _mend(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    """Mends the HTML of a page before it is written."""
    if "body" not in context:
        return
    context["body"] = with_lines_of_arguments(without_empty_headers(context["body"]))

    def address(name: str) -> str | None:
        found = app.env.domains.python_domain.objects.get(name)
        return f"{app.builder.get_relative_uri(page, found.docname)}#{found.node_id}" if found else None

    if page.startswith("_modules/"):
        module = page.removeprefix("_modules/").replace("/", ".")
        context["body"] = with_links_back(context["body"], module, address)


def _list_no_module_without_code(app: Sphinx) -> list[tuple[str, dict[str, Any], str]]:
    """Keeps ``builtins`` out of viewcode's list of modules, which has those without a page, too."""
    modules = getattr(app.env, "_viewcode_modules", {})
    for name in [name for name, entry in modules.items() if not entry]:
        del modules[name]
    return []


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _stay_on_the_site)
    app.connect("doctree-read", lambda app, doctree: keep_together(doctree))
    app.connect("include-read", _stay_on_the_site_too)
    app.connect("autodoc-process-signature", _show_own_arguments)
    app.connect("object-description-transform", _drop_quotes_of_ranges)
    app.connect("missing-reference", _find_where_public, priority=600)
    app.connect("html-page-context", _mend)
    app.connect("html-collect-pages", _list_no_module_without_code, priority=400)
