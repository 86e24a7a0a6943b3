from __future__ import annotations

import json
import re
from multiprocessing import Pipe
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from uavrl.cli import compare as compare_command
from uavrl.cli.compare import CompareConfig, _Flights, _wait_for, compare, main
from uavrl.errors import UavrlError
from uavrl.runs.progress_line import ProgressLine

FAILS_OFTEN = "SC" * 50


@pytest.fixture
def recorded(tmp_path: Path) -> dict[str, str]:
    """Files of a policy that always succeeds, one that fails every second task, and a suite of both."""
    outcomes = {"good": "S" * 100, "bad": FAILS_OFTEN}
    for name, letters in outcomes.items():
        (tmp_path / f"{name}.json").write_text(json.dumps({"seed": 20_000, "outcomes": letters}))
    (tmp_path / "suite.json").write_text(json.dumps({"dense": {"outcomes": "T" * 100}, "static": {"episodes": 3}}))
    return {path.stem: str(path) for path in tmp_path.glob("*.json")}


def test_recorded_evaluations_are_compared_until_one_is_better(recorded: dict[str, str]) -> None:
    found, outcomes = compare(CompareConfig(recorded["bad"], recorded["good"], block=10))
    assert found.better == "second" and found.tasks < 100 and found.won == 0
    assert outcomes == {"first": FAILS_OFTEN[: found.tasks], "second": "S" * found.tasks}


def test_equal_policies_take_all_tasks_and_neither_is_better(recorded: dict[str, str]) -> None:
    found, _ = compare(CompareConfig(recorded["good"], recorded["good"], block=30))
    assert (found.better, found.tasks, found.difference) == (None, 100, 0.0)


def test_the_row_of_a_suite_is_the_one_that_is_asked_for(recorded: dict[str, str]) -> None:
    found, _ = compare(CompareConfig(recorded["good"], recorded["suite"], row="dense"))
    assert found.better == "first"


def test_the_line_shows_how_many_tasks_both_have_flown(capsys: pytest.CaptureFixture[str]) -> None:
    told = []
    flights = {}
    for name in ("first", "second"):
        flight = flights[name] = _Flights.__new__(_Flights)
        ours, theirs = Pipe(duplex=False)
        flight._outcomes, flight._started = {}, [(None, ours, range(4))]  # type: ignore[list-item]
        told.append(theirs)
    for task, letter in enumerate("SCTS"):
        told[0].send((3 - task, letter))  # in another order
    told[1].send((0, "S"))
    told[1].send((1, "S"))
    with ProgressLine(4, "tasks") as line:
        _wait_for(2, flights, line)
        assert [flights[name].first(2) for name in flights] == ["ST", "SS"]
        told[1].send("There is no such policy.")
        with pytest.raises(UavrlError, match="no such policy"):
            _wait_for(4, flights, line)
        assert line.n == 2


def test_the_first_tasks_of_several_processes_are_waited_for_whatever_the_others_do() -> None:
    flight, told = _Flights.__new__(_Flights), []
    flight._outcomes, flight._started = {}, []
    for first in range(2):
        ours, theirs = Pipe(duplex=False)
        flight._started.append((None, ours, range(first, 6, 2)))  # type: ignore[arg-type]
        told.append(theirs)
    for task in (0, 2):
        told[0].send((task, "S"))
    for task in (3, 1):
        told[1].send((task, "C"))
    with ProgressLine(6, "tasks", enabled=False) as line:
        _wait_for(2, {"first": flight}, line)
        assert flight.first(2) == "SC"
        _wait_for(4, {"first": flight}, line)
    assert flight.first(4) == "SCSC" and flight.flown(6) == 4


def test_tasks_among_other_planes_are_not_compared_one_by_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about = {"seed": 20_000, "outcomes": "SC" * 50, "planes": 20, "env": "dynamic"}
    about["overrides"] = ["env=dynamic", "env.world.planes=20"]
    files = {}
    for name, more in {
        "eight": {"num_uavs": 8},
        "sixteen": {"num_uavs": 16},
        "two": {"num_uavs": 8, "processes": 2},
        "older": {},
    }.items():
        files[name] = str(tmp_path / f"{name}.json")
        Path(files[name]).write_text(json.dumps({**about, **more}))
    for same in ("eight", "older"):
        assert in_process(main, files["eight"], files[same], "row=busy", "block=50") == 0
    capsys.readouterr()
    for other, told in (("sixteen", "num_uavs=16 and processes=1"), ("two", "num_uavs=8 and processes=2")):
        assert in_process(main, files["eight"], files[other], "row=busy") == 1
        assert f"process: num_uavs=8 and processes=1 against {told}. Evaluate" in capsys.readouterr().err
    assert in_process(main, files["two"], "best", "row=busy", "processes=2") == 1
    assert "processes=2 of uavrl-compare" in capsys.readouterr().err, "which divides the tasks in another way"
    assert in_process(main, files["sixteen"], "best", "row=busy") == 1


def test_the_verdict_is_printed_and_written(
    recorded: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "result/found.json"
    assert in_process(main, recorded["good"], recorded["bad"], "row=dense", f"json={file}") == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith(recorded["good"]) and "  Success rate: 100.0 % (95 % CI " in told[0]
    assert told[-1].startswith(f"{recorded['good']} succeeds more often than {recorded['bad']} in dense, by at least ")
    result = json.loads(file.read_text())
    assert result["better"] == "first" and 0 < result["low"] < result["difference"] < result["high"]
    assert result["second"]["outcomes"] == FAILS_OFTEN[: result["tasks"]]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["best"], "Name two policies to compare"),
        (["best", "bst"], "did you mean best?"),
        (["best", "vfh", "row=dens"], "did you mean dense?"),
        (["best", "vfh", "error=0.7"], "error must be"),
        (["best", "vfh", "taks=3"], "did you mean tasks?"),
        (["best", "'vfh"], "cannot be read"),
        (["best", "vfh", "straight"], "uavrl-compare"),
        (["best", "vfh perception.rdius=3"], "There is no key 'perception.rdius'"),
        (["best", "vfh perception=valley"], "perception must be one of"),
        (["best", "vfh env.world.obstacles=3"], "row chooses the worlds"),
        (["best", "vfh +randomize=all"], "row chooses the worlds"),
        (["best", "none.json"], "none.json cannot be read"),
    ],
)
def test_mistakes_are_told_before_anything_flies(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert in_process(main, *words) == 1
    err = capsys.readouterr().err
    assert says in err and err.startswith("uavrl: ") and err.count("\n") == 1


@pytest.mark.parametrize(
    "text",
    [
        *("[]", "{", '{"outcomes": "SXS"}', '{"static": {"episodes": 3}}'),
        '{"outcomes": "S", "overrides": ["env.x=[1"]}',
    ],
)
def test_a_file_without_outcomes_is_refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.json").write_text(text)
    assert in_process(main, str(tmp_path / "a.json"), "best", "row=static") == 1
    assert "holds no outcomes of static" in capsys.readouterr().err


def test_files_of_other_tasks_are_refused(recorded: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(main, recorded["good"], recorded["bad"], "seed=7") == 1
    assert "tasks of seed 20000, not 7: add seed=20000." in capsys.readouterr().err


def test_files_of_other_worlds_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    about = {"seed": 20_000, "outcomes": "S" * 100, "env": "static"}
    for name, overrides in (("dense", ["env=static", "env.world.obstacles=90"]), ("plain", ["randomize=none"])):
        (tmp_path / f"{name}.json").write_text(json.dumps({**about, "overrides": overrides}))
    (tmp_path / "mesh.json").write_text(json.dumps({**about, "env": "mesh", "overrides": ["env=mesh"]}))
    dense, plain, mesh = (str(tmp_path / f"{name}.json") for name in ("dense", "plain", "mesh"))
    assert in_process(main, dense, dense, "row=dense", "block=50") == 0
    assert in_process(main, plain, plain, "row=held_out", "block=50") == 0
    for file in (plain, mesh):
        assert in_process(main, dense, file, "row=dense") == 1
        assert "was not flown in the worlds of row=dense" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("row", "overrides", "valleys", "says"),
    [
        ("held_out", ["valleys=training"], [0], "but in 0 instead of 100, 101, 102, …, 109"),
        ("held_out", [], list(range(106, 116)), "but in 106, 107, 108, …, 115 instead of 100"),
        ("static", [], list(range(100, 110)), "but in 100, 101, 102, …, 109 instead of 0"),
        ("held_out", ["env.max_speed=6"], list(range(100, 110)), "differ by env.max_speed=6"),
        ("fast6", ["env.max_speed=4"], list(range(100, 110)), "differ by env.max_speed=4, env.max_speed=6"),
        ("held_out", ["env.max_steps=100"], list(range(100, 110)), "differ by env.max_steps=100"),
        ("static", ["env.aerodynamics.wind=[3.0,0.0,0.0]"], [0], "differ by env.aerodynamics.wind"),
        ("held_out", ["randomize.mass=2"], list(range(100, 110)), "differ by randomize.mass=2"),
        ("sensor", ["perception.lidar.dropout=0.2"], [0], "differ by perception.lidar.dropout=0.2"),
        ("static", ["perception.lidar.dropout=0.1"], [0], None),  # as a policy that is flown may have it
        ("fast6", ["env.max_speed=6.0", "perception.lidar.far_range=12"], list(range(100, 110)), None),
        ("static", ["env.lidar=mid360", "valleys=training"], [0], None),
    ],
)
def test_a_file_of_other_valleys_speed_wind_or_flaws_is_refused(
    row: str, overrides: list[str], valleys: list[int], says: str | None, tmp_path: Path
) -> None:
    about = {"seed": 20_000, "outcomes": "S" * 100, "env": "static", "overrides": overrides, "valleys": valleys}
    (tmp_path / "one.json").write_text(json.dumps(about))
    asked = CompareConfig("one", "two", row=row)
    if says is None:
        assert compare_command._recorded(tmp_path / "one.json", asked)[0] == "S" * 100
        return
    with pytest.raises(UavrlError, match=re.escape(says)):
        compare_command._recorded(tmp_path / "one.json", asked)


def test_another_lidar_is_no_other_world() -> None:
    asked = CompareConfig("best", "vfh", row="static", tasks=9, seed=5)
    assert "env.lidar=mid360" in compare_command._overrides("vfh env.lidar=mid360", asked)


def test_a_side_may_have_keys_of_its_own() -> None:
    asked = CompareConfig("best", "vfh", row="static", tasks=9, seed=5)
    made = compare_command._overrides("vfh perception.radius=3", asked)
    assert made == ['policy="vfh"', "perception.radius=3", "valleys=training", "env=static", "seed=5", "progress=false"]


def test_the_name_of_a_folder_may_hold_what_a_key_has() -> None:
    words = ["runs/gamma=0.98_seed=1", "o'brien's \"best\" guards=none", "row=dense"]
    first, second, row = compare_command._named(words)
    assert (first, row) == ('first="runs/gamma=0.98_seed=1"', "row=dense")
    assert second == 'second="o\'brien\'s \\"best\\" guards=none"'
