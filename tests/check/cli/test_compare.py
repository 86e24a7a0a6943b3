"""``uavrl-compare`` with real flights, each policy in a process of its own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from uavrl.cli.compare import main as compare
from uavrl.cli.evaluate import main as evaluate


def test_flights_end_as_in_an_evaluation_of_the_same_tasks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        in_process(compare, "straight", "vfh", "row=static", "tasks=8", "block=4", "processes=2", "json=found.json")
        == 0
    )
    found = json.loads(Path("found.json").read_text())
    for name, policy in (("first", "straight"), ("second", "vfh")):
        told = f"{policy}.json"
        words = (f"policy={policy}", "env=static", "valleys=training", "episodes=8", "progress=false")
        assert in_process(evaluate, *words, f"output={told}") == 0
        flown = json.loads(Path(told).read_text())["outcomes"]
        assert found[name]["outcomes"] == flown[: found["tasks"]] and set(flown) <= {"S", "C", "T"}


def test_an_error_of_one_flight_ends_the_comparison(capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(compare, "vfh perception.radius=-1", "straight", "row=static", "tasks=4") == 1
    assert "perception.radius must be" in capsys.readouterr().err
