"""A simulated vehicle and our own link to an autopilot, in real time; and ``uavrl-sitl`` as a process."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.commands import VALLEY
from tests.helpers.measured import measured
from tests.helpers.signals import hearing
from tests.helpers.sitl import Ground, Scripted, fly, running
from tests.helpers.valleys import NEAR, SMALL
from uavrl.config import compose, validate
from uavrl.envs import NavigationEnv
from uavrl.sitl.live import PIECE, LiveEpisode
from uavrl.sitl.sitl import Sitl
from uavrl_onboard.autopilot.frames import to_goal
from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.lidar.packets import decode_vlp16

pytestmark = measured

REAL = validate(compose("randomize=real")).env.randomize


@pytest.fixture
def ground() -> Iterator[Ground]:
    made = Ground()
    with closing(made):
        yield made


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_our_own_link_gets_in_control_and_flies_it(ground: Ground, firmware: Any) -> None:
    episode = Scripted(ends_after=5.0)
    sitl = Sitl(episode, *ground.addresses, firmware=firmware, armed=False, linger=0.2)  # type: ignore[arg-type]
    thread = running(sitl)
    seen = fly(ground, 8.0, (1.0, 0.5, -0.25, 0.5), until=lambda: not thread.is_alive())
    thread.join(1.0)
    assert seen[-3:] == [Control.OTHER_MODE, Control.DISARMED, Control.IN_CONTROL]
    result = sitl.result
    assert result.outcome == "success" and result.setpoints >= 3 and result.rate > 0.9
    assert result.modes[-1][1] == ("OFFBOARD" if firmware == "px4" else "GUIDED")
    turned = [row for row in episode.flown if row[3] != 0.0]
    assert {round(row[3], 6) for row in turned} == {0.5} and {round(row[2], 6) for row in turned} == {-0.25}
    speeds = [math.hypot(*row[:2]) for row in turned]
    assert speeds == pytest.approx([math.hypot(1.0, 0.5)] * len(speeds), abs=1e-6)
    assert math.atan2(turned[0][1], turned[0][0]) == pytest.approx(math.atan2(0.5, 1.0), abs=1e-6)
    assert episode.flown[-1] == (0.0, 0.0, 0.0, 0.0)  # it lingers, whatever the set-points say
    assert result.seconds == pytest.approx(len(turned) * PIECE, abs=0.2)


def test_a_pilot_takes_over(ground: Ground) -> None:
    episode = Scripted()
    sitl = Sitl(episode, *ground.addresses, max_steps=24, linger=1.2, pilot_takes_over=1.2)  # type: ignore[arg-type]
    thread = running(sitl)
    seen = fly(ground, 7.0, (1.0, 0.0, 0.0, 0.0), until=lambda: not thread.is_alive())
    thread.join(4.0)
    assert Control.TAKEN_OVER in seen
    assert [mode for _, mode, _ in sitl.result.modes] == ["AUTO.LOITER", "OFFBOARD", "POSCTL"]
    assert sitl.result.outcome == "time_out" and sitl.result.steps == 24
    assert sum(row[0] > 0 for row in episode.flown) * PIECE == pytest.approx(1.2, abs=0.15)


def test_in_lockstep_each_obeyed_setpoint_is_a_step(ground: Ground) -> None:
    episode = Scripted()
    sitl = Sitl(episode, *ground.addresses, speed="lockstep", max_steps=12, linger=0.0)  # type: ignore[arg-type]
    thread = running(sitl)
    fly(ground, 6.0, (1.0, 0.5, -0.25, 2.0), until=lambda: not thread.is_alive())
    thread.join(1.0)
    assert sitl.result.outcome == "time_out" and sitl.result.steps == 12 and sitl.result.setpoints == 12
    assert [tuple(map(float, row)) for row in episode.flown] == [(1.0, 0.5, -0.25, 2.0)] * 12
    packets = ground.packets()
    assert len(packets) % 76 == 0
    last = np.linalg.norm(decode_vlp16(packets[-76:]), axis=1)
    assert last.mean() == pytest.approx(2.1, abs=0.002)  # after eleven steps: the scan that the last set-point answered


def test_a_command_plays_a_task_and_says_how_it_went(tmp_path: Path) -> None:
    """The goal is taken from its file, and flown to straight."""
    ground, told = Ground(), tmp_path / "task.json"
    lidar, autopilot = ground.addresses
    options = [f"lidar={lidar}", f"autopilot={autopilot}", f"json={told}", "linger=0.2"]
    command = [sys.executable, "-m", "uavrl.cli.sitl", *VALLEY, "env.world.obstacles=0", *options]
    with closing(ground), hearing(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        introduced = process.stdout.readline()
        task = json.loads(told.read_text())
        assert task["outcome"] is None and f"goal=[{task['goal'][0]:g}," in introduced
        with Autopilot(autopilot, set_mode=True) as link:
            deadline = time.monotonic() + 200
            while process.poll() is None:
                now = time.monotonic()
                assert now < deadline
                link.receive(now)
                pose = link.pose()
                ahead = np.zeros(4)
                if pose is not None:
                    read = to_goal(pose, task["goal"])
                    turn = math.radians((read["heading_deg"] + 180.0) % 360.0 - 180.0)
                    ahead = np.array([1.5 * (abs(turn) < 0.3), 0.0, 0.0, min(max(2.0 * turn, -1.0), 1.0)])
                link.send(ahead, now)
                time.sleep(0.1)
        said = process.stdout.read()
    result = json.loads(told.read_text())
    assert process.returncode == 0 and "\nSuccess after " in said
    assert result["outcome"] == "success" and result["goal"] == task["goal"] and result["least_distance"] < 2.0
    assert [mode for _, mode, _ in result["modes"]] == ["AUTO.LOITER", "OFFBOARD"]
    assert result["rate"] > 0.5


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_ends_it_with_what_came_of_it(tmp_path: Path, number: int, code: int) -> None:
    told = tmp_path / "task.json"
    ground = Ground()
    options = [f"lidar={ground.addresses[0]}", f"autopilot={ground.addresses[1]}", f"json={told}"]
    command = [sys.executable, "-m", "uavrl.cli.sitl", *VALLEY, *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with closing(ground), hearing(command, **pipes) as process:
        assert process.stdout is not None and process.stdout.readline()
        time.sleep(0.5)
        process.send_signal(number)
        _, errors = process.communicate(timeout=20)
    assert process.returncode == code and errors.endswith("uavrl: stopped: No set-point was obeyed.\n")
    assert json.loads(told.read_text())["outcome"] == "stopped"


def test_in_lockstep_it_is_the_environment_bit_by_bit() -> None:
    """A companion that answers each scan by the same actions flies the same episode."""
    env, ground = NavigationEnv(1, world=SMALL, lidar=NEAR, seed=5, randomize=REAL), Ground()
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (12, 4)).astype(np.float32)
    state, places = env.reset(task=1), []
    for action in actions:
        state = env.step(state.set("action", torch.from_numpy(action)[None]))["next"]
        places.append(env.simulation.position[0].copy())
    env.set_seed(5)
    begun: list[np.ndarray] = []
    seen: list[np.ndarray] = []

    class Watched(LiveEpisode):
        def step(self, command: np.ndarray) -> None:
            begun.append(command)
            super().step(command)
            seen.append(env.simulation.position[0].copy())

    sitl = Sitl(Watched(env, 1), *ground.addresses, speed="lockstep", max_steps=12, linger=0.0)
    thread = running(sitl)
    with closing(ground), Autopilot(ground.addresses[1], set_mode=True) as link:
        while thread.is_alive():
            now, flown = time.monotonic(), len(seen)
            link.receive(now)
            if len(begun) == flown:  # else a late copy would be obeyed in the next step
                link.send(actions[min(flown, 11)], now)
            while thread.is_alive() and len(seen) == flown and time.monotonic() < now + 0.3:
                time.sleep(0.001)
    np.testing.assert_array_equal(seen, places)
    env.close()
