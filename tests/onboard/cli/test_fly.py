"""``uavrl-fly``: dry runs of a recording and of a sensor, and what a user may get wrong."""

from __future__ import annotations

import errno
import json
import os
import shutil
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.tests.lidar.test_senders import capture
from tests.helpers.commands import in_process
from tests.helpers.exported import edit_contract, exported
from tests.helpers.measured import measured
from tests.helpers.packets import RECORDED
from tests.helpers.ports import free_ports
from tests.helpers.recordings import CLOUD, cloud_message, store, write_bag
from uavrl_onboard.cli import flight_end, fly
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.logged_flight import LoggedFlight
from uavrl_onboard.flight.loop import Flight
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.lidar.packets import encode_scan
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.policy.contract_parts import GuardTerms
from uavrl_onboard.vehicle import Vehicle

RECORDING = (f"lidar={RECORDED}", "model=VLP16", "autopilot=null", "log=null")
GOAL = "goal=[20,0,2.5]"


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("exported"), "algo.hidden=[16,8]")


def test_a_recording_is_flown_into_nothing(policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "flight.json"
    assert in_process(fly.main, f"policy={policy}", GOAL, *RECORDING, f"json={numbers}") == 0
    out, err = capsys.readouterr()
    assert "0.0 s  silent (settling): all rules must hold for 1 s first" in out
    assert err == "Vehicle: in_control (a dry run: set-points are sent to nobody)\n"
    assert "0.1 s, 2 scans: it did not arrive, 20.0 m from the goal at the nearest." in out
    assert f"Written to {numbers}" in out
    facts = json.loads(numbers.read_text())
    assert (facts["scans"], facts["cycles"], facts["arrived"], facts["least_distance_m"]) == (2, 2, False, 20.0)
    assert 0.0 < facts["latency_ms"]["median"] < 1000.0


@measured
def test_a_sensor_is_flown_by_until_the_goal(policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers, ended, (port, _) = tmp_path / "flight.json", threading.Event(), free_ports()

    def turn() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
            begun = time.monotonic()
            for number in range(250):
                for packet in encode_scan(3.0 * firing_directions(), stamp=0.1 * number):
                    sensor.sendto(packet, ("127.0.0.1", port))
                if ended.wait(max(begun + 0.1 * number - time.monotonic(), 0.0)):
                    return

    sensor = threading.Thread(target=turn)
    sensor.start()
    try:
        where = (
            f"lidar=udp://127.0.0.1:{port}",
            "model=VLP16",
            "autopilot=null",
            "standing=[19.5,0,3.5,0]",
            "hold=0.2",
        )
        assert in_process(fly.main, f"policy={policy}", GOAL, *where, "log=null", f"json={numbers}", "seconds=20") == 0
    finally:
        ended.set()
        sensor.join()
    facts = json.loads(numbers.read_text())
    assert facts["arrived"] and facts["least_distance_m"] == 0.5
    assert 1.0 <= facts["arrived_after_s"] <= facts["seconds"] < 20.0
    assert "flying (in_control): the policy flies" in capsys.readouterr().out


def test_without_a_scan_it_says_why(policy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = (f"lidar=udp://127.0.0.1:{free_ports()[0]}", "model=VLP16", "autopilot=null", "log=null", "seconds=3.4")
    assert in_process(fly.main, f"policy={policy}", GOAL, *where) == 0
    out = capsys.readouterr().out
    assert "0.0 s  silent (no_scan): there is no scan" in out
    assert out.count("No scan has come for 3 s: no packet arrived. Set this computer's address") == 1


def test_a_flight_is_logged(policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = [each for each in RECORDING if each != "log=null"]
    for name in ("flight.mcap", "flight_2.mcap"):
        assert in_process(fly.main, f"policy={policy}", GOAL, *recording, f"log={tmp_path / 'flight.mcap'}") == 0
        assert f"Log: {tmp_path / name}, which uavrl-replay" in capsys.readouterr().out
        logged = LoggedFlight(tmp_path / name)
        cycles = list(logged)
        assert logged.whole and logged.goal == (20.0, 0.0, 2.5) and logged.about["autopilot"] == "None"
        scans = [points for _, points in ScanSource(RECORDED, "VLP16")]
        for cycle, points in zip(cycles, scans, strict=True):
            assert cycle.scan is not None and np.array_equal(cycle.scan.points, points)


def test_a_floor_below_the_ground_is_told(policy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lidar, autopilot = free_ports()
    where = (f"lidar=udp://127.0.0.1:{lidar}", "model=VLP16", f"autopilot=udp://127.0.0.1:{autopilot}", "log=null")
    for floor, told in (("-2", 1), ("1", 0)):
        assert in_process(fly.main, f"policy={policy}", GOAL, *where, f"safety.floor={floor}", "seconds=0.2") == 0
        assert capsys.readouterr().err.count("safety.floor is below the ground") == told


def test_a_pipe_that_nobody_reads_ends_no_flight(
    policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers, (reader, writer) = tmp_path / "flight.json", os.pipe()
    os.close(reader)
    monkeypatch.setattr(sys, "stdout", os.fdopen(writer, "w"))
    monkeypatch.setattr(
        "uavrl_onboard.cli.nonblocking_output._LONGEST_END", 30.0
    )  # on a machine that has much else to do
    where = (f"lidar=udp://127.0.0.1:{free_ports()[0]}", "model=VLP16", "autopilot=null", "log=null", "seconds=0.5")
    assert in_process(fly.main, f"policy={policy}", GOAL, *where, f"json={numbers}") == 141
    assert json.loads(numbers.read_text())["seconds"] >= 0.5
    assert "Nobody reads what is printed (Broken pipe): the flight goes on." in capsys.readouterr().err


@pytest.mark.parametrize(("half", "reason"), [(True, "half_scan"), (False, "empty_scans")])
def test_a_recording_that_does_not_see_is_not_flown_to_its_end(
    half: bool, reason: str, policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    types, seen = store(), 3.0 * firing_directions()[::8].astype(np.float32)
    points = seen[seen[:, 0] > 0] if half else seen[:0]
    messages = [cloud_message(types, points, 5.0 + 0.1 * n) for n in range(40)]
    path, numbers = write_bag(tmp_path / "a", "db3", {"/a": (CLOUD, messages)}), tmp_path / "a.json"
    where = (f"lidar={path}", "autopilot=null", "log=null", f"json={numbers}")
    assert in_process(fly.main, f"policy={policy}", GOAL, *where) == 0
    changes = [(state, why) for _, state, why, _ in json.loads(numbers.read_text())["changes"]]
    assert changes[-1] == ("silent", reason)
    assert f"({reason}): " in capsys.readouterr().out


def test_what_is_odd_about_a_recording_is_told(
    policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = capture(tmp_path / "a.pcap", bytes([192, 168, 1, 202]), 2368)
    where = (f"lidar={path}", "model=VLP16", "autopilot=null", "log=null")
    assert in_process(fly.main, f"policy={policy}", GOAL, *where) == 0
    assert "uavrl: Two senders: only 192.168.1.201:2368 is read" in capsys.readouterr().err


@pytest.mark.parametrize("fails", [False, True])
def test_how_a_flight_ended_is_told_before_its_numbers_are_written(
    fails: bool, policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the disk is full, and where the flight itself ends with an error."""

    def full(path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    def broken(flight: Any, scans: Any, link: Any) -> Any:
        yield next(rehearse(flight, scans, link))
        raise UavrlError("the recording ends in the middle.")

    rehearse, numbers, log = fly.rehearse, tmp_path / "a.json", tmp_path / "a.mcap"
    if fails:
        monkeypatch.setattr(fly, "rehearse", broken)
    monkeypatch.setattr(flight_end, "replacing", full)
    recording = [*(each for each in RECORDING if each != "log=null"), f"log={log}", f"json={numbers}"]
    assert in_process(fly.main, f"policy={policy}", GOAL, *recording) == 1
    out, err = capsys.readouterr()
    assert "scans: it did not arrive" in out or "1 scan: it did not arrive" in out
    assert f"Log: {log}, which uavrl-replay" in out
    assert "No space left on device" in err and not numbers.exists()
    assert ("the recording ends in the middle." in err) is fails
    logged = LoggedFlight(log)
    assert list(logged) and logged.whole


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([GOAL], "policy must be a folder that uavrl-export wrote, got None"),
        (["policy=none", GOAL], "Expected an exported policy with none/contract.json"),
        (["policy=none"], "goal must be three numbers, [x,y,z] in m from the autopilot's origin, got None"),
        (["policy=none", "goal=[1,2]"], "goal must be three numbers"),
        (
            ["policy=none", "goal=[9,0,7]"],
            "goal (9, 0, 7) lies 2.0 m outside the fence's ceiling: see goal= and safety",
        ),
        (
            ["policy=none", GOAL, "safety.box=[-5,-5,5,5]"],
            "lies 15.0 m outside the fence's wall: see goal= and safety.box=",
        ),
        (["policy=none", GOAL, f"lidar={RECORDED}"], "a recording flies nothing but autopilot=null"),
        (["policy=none", GOAL, "safety.velocity=0"], "safety.velocity must be a finite number above 0, got 0"),
        (["policy=none", GOAL, "safety.floor=8"], "floor 8 must be below ceiling 5"),
        (["policy=none", GOAL, "safety.box=[1,2,3]"], "safety.box must be a list of 4, got [1, 2, 3]"),
        (["policy=none", GOAL, "vehicle=[1,2,3]"], "vehicle must be six numbers"),
        (["policy=none", GOAL, "standing=[1,2,3]"], "standing must be a list of 4"),
        (["policy=none", GOAL, "autopilot=ros2:///odom", "arm=true"], "autopilot must be udp://:14540 with arm"),
        (["policy=none", GOAL, "autopilot=ros2:///odom", "ros2.kind=px5"], "ros2.kind must be one of"),
        (["policy=none", GOAL, "system=0"], "system must be"),
        (["policy=none", GOAL, "autopilot=ros2:///odom", "signing_key_file=k"], "udp://:14540 with signing_key_file"),
        (["policy=none", GOAL, "hull.radius=0"], "hull.radius must be above 0, got 0"),
        (
            ["policy=none", GOAL, "hull.elevations=[52,-7]"],
            "hull.elevations must be [lowest,highest] in [-90, 90] degrees, got",
        ),
        (["policy=none", GOAL, "hull.elevations=40"], "hull.elevations must be a list, got 40"),
        (["policy=none", GOAL, "guards=typo"], "There is no guard 'typo'; the guards are map, evasion, shield"),
        (["policy=none", GOAL, "guards=[map,typo]"], "There is no guard 'typo'; the guards are map, evasion, shield"),
        (["policy=none", GOAL, "guards.shield.margin=-1"], "guards.shield.margin must be at least 0, got -1"),
        (["policy=none", GOAL, "guards.shield.margn=1"], "did you mean guards.shield.margin?"),
        (["policy=none", GOAL, "json=./flight.mcap"], "json must be another file than the log and the recording"),
        (["policy=none", GOAL, *RECORDING, f"json={RECORDED}"], "json must be another file than the log"),
        (["policy=none", GOAL, "safety.speed=1"], "There is no key 'safety.speed'"),
        (["policy=none", GOAL, "guards.evasion.sight=0"], "guards.evasion.sight must be in (0, 100], got 0"),
    ],
)
def test_what_a_user_may_get_wrong(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(fly.main, *arguments) == 1
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error


def test_a_port_that_is_taken(policy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        where = (f"lidar=udp://127.0.0.1:{port}", "model=VLP16", "autopilot=null", "log=null")
        assert in_process(fly.main, f"policy={policy}", GOAL, *where) == 1
    assert f"udp://127.0.0.1:{port} cannot be listened to" in capsys.readouterr().err


def test_the_model_is_named(policy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(fly.main, f"policy={policy}", GOAL, "autopilot=null", "log=null") == 1
    assert "model must be one of VLP16" in capsys.readouterr().err


def test_guards_are_the_contracts_or_those_asked_for_and_know_the_vehicle(
    policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = list[Guards]()

    def kept(*arguments: Any, guards: Guards, **stages: Any) -> Flight:
        made.append(guards)
        return Flight(*arguments, guards=guards, **stages)

    monkeypatch.setattr(fly, "Flight", kept)
    guarded = shutil.copytree(policy, tmp_path / "guarded")
    terms = GuardTerms.of(GuardSettings.all(), Vehicle(radius=0.4))
    assert terms is not None
    edit_contract(guarded, lambda contract: contract.update(guards=terms.model_dump(mode="json")))
    recording = [*(each for each in RECORDING if each != "log=null"), f"log={tmp_path / 'flight.mcap'}"]
    vehicle = (
        "hull.radius=0.3",
        "hull.height=0.2",
        "hull.sensor=0.15",
        "hull.elevations=[-7,52]",
        "hull.repeats=false",
        "safety.velocity=1.5",
    )
    for folder, told in (
        (guarded, ("guards.shield.margin=0.2", *vehicle)),
        (guarded, ()),
        (guarded, ("guards=none",)),
        (policy, ("guards=[evasion]", "guards.evasion.sight=9")),
        (policy, ()),
    ):
        assert in_process(fly.main, f"policy={folder}", GOAL, *recording, *told) == 0
    assert [guards.settings.names for guards in made] == [("map", "evasion", "shield")] * 2 + [(), ("evasion",), ()]
    own, usual, *_ = (guards.vehicle for guards in made)
    assert (own.hull, own.lidar_above, own.velocity_limit) == ((0.3, 0.1), 0.15, 1.5)
    assert (own.lidar_elevations, own.lidar_repeats) == ((-7, 52), False)
    assert (usual.lidar_elevations, usual.lidar_repeats) == ((-15, 15), True)
    assert (usual.hull, usual.lidar_above, usual.velocity_limit) == ((0.4, 0.14), 0.1, 2.0)
    changed, far = made[0].settings.shield, made[3].settings.evasion
    assert changed is not None and changed.margin == 0.2 and far is not None and far.sight == 9.0
    assert "Guards: map, evasion, shield." in capsys.readouterr().out
    assert json.loads(LoggedFlight(tmp_path / "flight.mcap").about["guards"])["shield"]["margin"] == 0.2
