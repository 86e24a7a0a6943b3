"""The pages' links lead somewhere, and what is kept beside them stays small."""

from __future__ import annotations

import importlib
import json
import re
import runpy
import subprocess
from pathlib import Path

import pytest

from uavrl.errors import UavrlError

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "docs/tutorials").glob("*.py")])
MEGABYTE = 1_000_000


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links, on GitHub and on the site."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, heading = target.partition("#")
        found = page.parent / path if path else page
        assert found.exists(), target
        assert not heading or heading in anchors(found), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_includes_is_there(page: Path) -> None:
    for target, name in re.findall(
        r"^```\{literalinclude\} (\S+)\n(?::pyobject: (\w+))?", page.read_text(encoding="utf-8"), re.MULTILINE
    ):
        assert re.search(
            rf"^(class|def) {name}\b" if name else "", (page.parent / target).read_text(encoding="utf-8"), re.MULTILINE
        ), name


def test_the_tests_that_the_table_of_faults_names_are_there() -> None:
    named = set(re.findall(r"`(test_\w+)`", (ROOT / "docs/safety_layer.md").read_text(encoding="utf-8")))
    tests = {path.stem for folder in ("tests", "onboard/tests") for path in (ROOT / folder).rglob("test_*.py")}
    assert named and named <= tests, named - tests


def tracked(folder: str) -> list[Path]:
    """The files below a folder that git keeps."""
    if not (ROOT / ".git").exists():
        pytest.skip("needs a git checkout")
    listed = subprocess.run(["git", "ls-files", "-z", folder], cwd=ROOT, capture_output=True, text=True, check=True)
    files = [ROOT / name for name in listed.stdout.split("\0") if name]
    return [file for file in files if file.is_file()]  # not what is being deleted


@pytest.mark.parametrize(("folder", "most"), [("docs", 4 * MEGABYTE), (".", 12 * MEGABYTE)])
def test_a_checkout_stays_small(folder: str, most: int) -> None:
    assert sum(file.stat().st_size for file in tracked(folder)) <= most


def test_pictures_and_tables_stay_small() -> None:
    most = {".gif": 1_000_000, ".png": 150_000, ".svg": 150_000}
    for file in tracked("docs"):
        assert file.stat().st_size <= most.get(file.suffix, 100_000), f"{file}: quantise, compress or shorten it"


def test_data_names_runs_and_not_the_folders_of_a_machine() -> None:
    files = [file for file in tracked("docs/data") if file.suffix == ".json"]
    assert files and not [file.name for file in files if re.search(r'"(run|path)": "/', file.read_text("utf-8"))]


def test_the_site_shows_what_the_tutorials_import() -> None:
    folder = ROOT / "docs/tutorials"
    assert "```{literalinclude} shell.py\n" in (folder / "index.md").read_text(encoding="utf-8")
    for script in sorted(folder.glob("*.py")):
        text = script.read_text(encoding="utf-8")
        assert "from shell import" not in text or "](index.md#what-they-share)" in text, script


def test_what_the_best_policy_reads_is_what_its_contract_says() -> None:
    contract, page = "uavrl/policies/data/best/contract.json", (ROOT / "docs/policies.md").read_text(encoding="utf-8")
    told = runpy.run_path(str(ROOT / "docs/figures/inputs_table.py"))["table"](ROOT / contract)
    assert told.startswith("237 numbers") and told in page, f"python docs/figures/inputs_table.py {contract}"
    counted = [int(last or first) for first, last in re.findall(r"^\| (\d+)(?:–(\d+))? \|", told, re.MULTILINE)]
    assert counted == [71, 72, 73, 74, 78], "72 cells, altitude, two angles and the last action, without a gap"
    with pytest.raises(UavrlError, match=r"Expected a contract\.json, as uavrl-export writes it, in .*suite\.json"):
        runpy.run_path(str(ROOT / "docs/figures/inputs_table.py"))["table"](
            ROOT / "uavrl/policies/data/best/suite.json"
        )


def test_what_a_policy_may_be_trusted_with_is_what_its_suite_found() -> None:
    example = runpy.run_path(str(ROOT / "docs/figures/suite_table.py"))
    rows = example["table"](ROOT / "uavrl/policies/data/best/suite.json")
    again = "python docs/figures/suite_table.py uavrl/policies/data/best/suite.json --page docs/deploy.md"
    assert example["BEGIN"] + rows + example["END"] in (ROOT / "docs/deploy.md").read_text(encoding="utf-8"), again


PLANNERS = {
    "`potential_field`": ["docs/data/rivals/potential_field.json"],
    "`vfh`": ["docs/data/suite/vfh_turning.json", "docs/data/rivals/vfh.json", "docs/data/suite/vfh_motion.json"],
    "`vfh_star`": ["docs/data/rivals/vfh_star.json"],
    "`mppi`": ["docs/data/rivals/mppi.json"],
    "`rrt_connect`": ["docs/data/rivals/rrt_connect.json"],
    "`rrt_map`": ["docs/data/rivals/rrt_map.json"],
    "`best`": ["uavrl/policies/data/best/suite.json"],
    "`best`, shield": ["docs/data/suite/shielded.json"],
    "`best`, map": ["docs/data/suite/best_memory.json"],
    "`best`, all": ["docs/data/suite/guards.json"],
    "`best_dynamic`": ["uavrl/policies/data/best_dynamic/suite.json"],
}


def test_the_planners_page_tells_what_they_were_found_to_do() -> None:
    example = runpy.run_path(str(ROOT / "docs/figures/scenarios.py"))
    policies = [
        (name, {world: row for file in files for world, row in example["read"](f"x={ROOT / file}")[1].items()})
        for name, files in PLANNERS.items()
    ]
    rows = example["table"](policies, ["held_out", "dense", "denser", "real", "traps", "dynamic"])
    page = (ROOT / "docs/howto/planners.md").read_text(encoding="utf-8")
    assert rows in page, rows
    told = [[json.loads((ROOT / file).read_text(encoding="utf-8")) for file in files] for files in PLANNERS.values()]
    planners = told[: list(PLANNERS).index("`best`")]
    dense = [next(found["dense"] for found in reversed(each) if "dense" in found) for each in planners]
    steps = [str(round(found["steps_per_arrival"])) for found in dense]
    assert f"| steps per success in `dense` | {' | '.join(steps)} |" in page, steps


HOW_TO = sorted((ROOT / "docs/howto").glob("*.md"))
HOW_TO_INDEX = ROOT / "docs/howto/index.md"


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_a_how_to_says_what_to_type_and_is_in_the_index(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert page.stem == "index" or re.search(r"^```(sh|python|bibtex)\n", text, re.MULTILINE)
    assert page.stem == "index" or f"]({page.name})" in HOW_TO_INDEX.read_text(encoding="utf-8")


@pytest.mark.parametrize("room", ["buffers", "envs", "losses", "models", "transforms"])
def test_the_reference_has_each_public_name_of_a_room(room: str) -> None:
    """A page that leaves names out says which, and another page has these."""
    pages = "\n".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs/api").glob("*.md")))
    shown = set(re.findall(rf"auto(?:class|function|data):: uavrl\.{room}\.(\w+)", pages))
    whole = re.search(rf"automodule:: uavrl\.{room}\n(?:   :exclude-members: (.*)\n)?", pages)
    left_out = (
        set((whole[1] or "").split(", ")) - {""} if whole else set(importlib.import_module(f"uavrl.{room}").__all__)
    )
    assert left_out <= shown, left_out - shown
