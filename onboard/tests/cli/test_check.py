"""``uavrl-check`` without a vehicle: what it refuses, prints and writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.helpers.commands import in_process
from tests.helpers.packets import RECORDED

from uavrl_onboard.cli import check
from uavrl_onboard.cli.command import keys
from uavrl_onboard.cli.fly import FlyConfig
from uavrl_onboard.cli.scan import ScanConfig
from uavrl_onboard.flight.check import Item, Level

GOAL = "goal=[20,0,2.5]"


def test_a_policy_that_cannot_be_read_is_the_only_item(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "check.json"
    assert in_process(check.main, f"policy={tmp_path}", GOAL, "model=VLP16", f"json={numbers}") == 1
    out = capsys.readouterr().out
    assert out.startswith("fail  policy         Expected an exported policy with") and "1 fail: do not take off." in out
    told = json.loads(numbers.read_text())
    assert told["passed"] is False and [(item["name"], item["level"]) for item in told["items"]] == [("policy", "fail")]


def test_a_recording_is_no_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = (f"policy={tmp_path}", GOAL, "model=VLP16", f"lidar={RECORDED}", "autopilot=null")
    assert in_process(check.main, *keys) == 1
    assert "lidar must be a sensor, udp://:2368 or ros2:///TOPIC, for a check" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("levels", "code", "says"),
    [
        ((Level.PASS, Level.PASS), 0, "2 pass: all is there."),
        ((Level.PASS, Level.WARN), 2, "1 pass, 1 warn: take off once you can explain each warning."),
        ((Level.WARN, Level.FAIL), 1, "0 pass, 1 warn, 1 fail: do not take off."),
    ],
)
def test_the_exit_code_is_0_only_where_all_pass(
    levels: Any,
    code: int,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(check, "check", lambda settings: [Item("one", level, "It is so.") for level in levels])
    assert in_process(check.main, f"policy={tmp_path}", GOAL, "model=VLP16") == code
    out = capsys.readouterr().out.splitlines()
    assert out[-1] == says and out[0] == f"{levels[0].value}  one            It is so."


@pytest.mark.parametrize("kind", [FlyConfig, ScanConfig])
def test_every_key_is_explained(kind: type[Any]) -> None:
    assert [key.name for key in keys(kind) if not key.meaning] == []
