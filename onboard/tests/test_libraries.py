"""A missing library is named together with the extra that installs it."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest
import tomllib

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.libraries import needed

ONBOARD = Path(__file__).parents[2] / "onboard"
WITH = {"lz4": "mcap", "zstandard": "mcap", "ouster": "ouster-sdk"}  # which library brings them


def calls() -> dict[tuple[str, str], str]:
    """Each library that is imported by ``needed`` with its extra, and a file that does."""
    found = {}
    for path in (ONBOARD / "uavrl_onboard").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "needed":
                library = re.findall(r"[\w-]+", ast.unparse(node.args[0]).removeprefix("f"))[0]
                extra = node.args[2].value if isinstance(node.args[2], ast.Constant) else "lidar"  # McapFile's own
                found[library.replace("_", "-"), extra] = path.name
    return found


def test_each_extra_installs_what_its_error_names() -> None:
    extras = tomllib.loads((ONBOARD / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    installs = {name: {re.split(r"[>=<;\[ ]", each)[0] for each in listed} for name, listed in extras.items()}
    named = calls()
    assert {library for library, _ in named} == {
        *("onnxruntime", "dpkt", "velodyne-decoder", "rosbags", "mcap", "zstandard", "lz4"),
        *("pymavlink", "cyclonedds", "plotly", "ouster"),
    }
    assert {extra for _, extra in named} == set(extras) - {"all"}
    for (library, extra), file in named.items():
        assert WITH.get(library, library) in installs[extra], file


def test_a_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "velodyne_decoder", None)
    with pytest.raises(UavrlError) as caught:
        needed("velodyne_decoder", "This", "lidar", ", or do without")
    assert str(caught.value) == "This needs velodyne-decoder: pip install 'uavrl-onboard[lidar]', or do without."


def test_a_library_that_cannot_be_imported_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wheel for another NumPy raises ImportError, and one whose own library is missing names that one."""
    (tmp_path / "broken_wheel.py").write_text("raise ImportError('numpy is\\ntoo new')")
    (tmp_path / "lacking.py").write_text("import not_there")
    (tmp_path / "older.py").write_text("raise SystemError('an exception set')")
    monkeypatch.syspath_prepend(tmp_path)
    causes = {"broken_wheel": "numpy is too new", "lacking": "No module named 'not_there'", "older": "an exception set"}
    for module, told in causes.items():
        name = module.replace("_", "-")
        with pytest.raises(UavrlError) as caught:
            needed(module, "This", "onnx")
        sentence = f"This needs {name}, which cannot be imported ({told}): pip install 'uavrl-onboard[onnx]'."
        assert str(caught.value) == sentence


def test_an_interruption_while_a_library_loads_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As pybind11 makes an ImportError of Ctrl-C while ONNX Runtime loads."""
    lines = "try:", " raise KeyboardInterrupt", "except KeyboardInterrupt as error:", " raise ImportError from error"
    (tmp_path / "interrupted_library.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        needed("interrupted_library", "A policy", "onnx")
