"""What a release must agree on: versions, Pythons, and the addresses that nobody knows before it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import uavrl
import uavrl_onboard

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
ONBOARD = tomllib.loads((ROOT / "onboard/pyproject.toml").read_text(encoding="utf-8"))["project"]
LINK = re.compile(r"\]\((?!#)(.+?)\)")


def workflow(name: str) -> dict[str, Any]:
    return yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def citation() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


def test_all_places_name_one_version(citation: dict[str, Any]) -> None:
    assert uavrl.__version__ == uavrl_onboard.__version__
    assert f"uavrl-onboard=={uavrl.__version__}" in PROJECT["dependencies"]
    assert all("version" in project["dynamic"] for project in (PROJECT, ONBOARD)), "each is read from __init__.py"
    released = re.search(r"^## (\d\S*) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert released is not None and released.groups() == (citation["version"], str(citation["date-released"]))
    assert uavrl.__version__ == citation["version"] or ".dev" in uavrl.__version__


def test_how_to_cite_says_what_the_citation_file_says(citation: dict[str, Any]) -> None:
    page = (ROOT / "docs/howto/cite.md").read_text(encoding="utf-8")
    software, thesis = (
        dict(re.findall(r"(\w+) += \{+(.*?)\}+,?$", entry, re.MULTILINE)) for entry in page.split("@")[1:]
    )
    assert software == {
        "title": citation["title"],
        "author": citation["authors"][0]["name"],
        "year": str(citation["date-released"].year),
        "version": citation["version"],
    }
    (reference,) = citation["references"]
    (author,) = reference["authors"]
    assert thesis == {
        "title": reference["title"],
        "author": f"{author['family-names']}, {author['given-names']}",
        "year": str(reference["year"]),
    }


def pythons(project: dict[str, Any]) -> list[str]:
    return [name.rpartition(" ")[2] for name in project["classifiers"] if re.search(r":: 3\.\d+$", name)]


def test_the_workflows_try_each_python_that_is_promised() -> None:
    promised = pythons(PROJECT)
    assert promised == ["3.11", "3.12", "3.13"]
    assert workflow("release")["jobs"]["try-onboard"]["strategy"]["matrix"]["python"] == pythons(ONBOARD)
    assert workflow("tests")["jobs"]["tests"]["strategy"]["matrix"]["python"] == promised
    assert workflow("release")["jobs"]["try"]["strategy"]["matrix"]["python"] == promised


def test_both_packages_are_built_and_the_one_that_the_other_needs_is_published_first() -> None:
    jobs = workflow("release")["jobs"]
    built = " ".join(step.get("run", "") for step in jobs["build"]["steps"])
    published = [step["with"]["packages-dir"] for step in jobs["publish"]["steps"] if "pypi-publish" in step["uses"]]
    assert published == ["dist/onboard", "dist/uavrl"] and all(f"--outdir {folder}" in built for folder in published)
    assert jobs["publish"]["needs"] == ["try", "try-onboard"]


def test_each_command_belongs_to_one_package() -> None:
    assert not set(PROJECT["scripts"]) & set(ONBOARD["scripts"]), "removing one package would remove the other's"


@pytest.mark.parametrize("name", ["tests", "docs", "release"])
def test_what_the_workflows_install_is_cached(name: str) -> None:
    for job, content in workflow(name)["jobs"].items():
        for step in content["steps"]:
            if step.get("uses", "").startswith("actions/setup-python") and (name, job) != ("release", "build"):
                assert step["with"]["cache"] == "pip", job
                assert step["with"]["cache-dependency-path"].split() == ["constraints.txt", "pyproject.toml"], job


def test_addresses_are_placeholders_until_the_release_page_has_been_followed() -> None:
    assert set(PROJECT["urls"]) == {"Homepage", "Documentation", "Changelog", "Issues"}
    owners = {re.sub(r"https://(github\.com/)?([\w-]+).*", r"\2", address) for address in PROJECT["urls"].values()}
    assert len(owners) == 1, "one account holds repository and site"
    page = (ROOT / "docs/release.md").read_text(encoding="utf-8")
    assert owners != {"OWNER"} or "sed -i 's/OWNER/" in page
    assert "! grep -n OWNER pyproject.toml onboard/pyproject.toml" in [
        step.get("run") for step in workflow("release")["jobs"]["build"]["steps"]
    ]


def test_on_pypi_each_link_of_the_readme_leads_to_the_files_of_the_tag() -> None:
    owner = PROJECT["urls"]["Homepage"].split("/")[3]
    shown = plain = (ROOT / "README.md").read_text(encoding="utf-8")
    for each in PYPROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        shown = re.sub(each["pattern"], each["replacement"], shown)
    for before, after in zip(LINK.findall(plain), LINK.findall(shown), strict=True):
        if before.startswith("https:"):
            assert after == before
            continue
        host = "https://raw.githubusercontent.com" if before.endswith((".gif", ".png")) else "https://github.com"
        assert after.startswith(f"{host}/{owner}/uavrl/") and after.endswith(f"/v$HFPR_VERSION/{before}")
        assert (ROOT / before.partition("#")[0]).exists(), before


def test_an_sdist_holds_what_is_there() -> None:
    for name in PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]:
        assert (ROOT / name.lstrip("/")).exists(), name
