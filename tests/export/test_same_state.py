"""What a policy reads over packets and MAVLink is what it has read in the simulator."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.commands import VALLEY
from tests.helpers.exported import exported
from tests.helpers.wire import Wire
from uavrl.config import compose, validate
from uavrl.evaluation.environment import make_env
from uavrl_onboard.flight.safety import SafetyState
from uavrl_onboard.policy.policy import Policy

TASK, STEPS = 1, 15


def flown(wire: Wire, env: Any) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """The states that the flight has read, those of the simulator, and what it was told to fly."""
    state = env.reset(task=TASK)
    wire.hand_over(state["point_cloud"][0].numpy())
    expected, commands = [], []
    for _ in range(STEPS):
        expected.append(state["observation"][0].numpy())
        assert wire.cycle(state["point_cloud"][0].numpy()).status.state in (SafetyState.FLYING, SafetyState.FENCED)
        commands.append(wire.command())
        state = env.step(state.set("action", torch.as_tensor(commands[-1], dtype=torch.float32)[None]))["next"]
    frames = wire.policy.contract.state.frames
    found, wanted = (np.reshape(each, (STEPS, frames, -1)) for each in (wire.read[-STEPS:], expected))
    return found, wanted, commands


@pytest.mark.parametrize("perception", ["range_image", "truncated_icosahedron"])
def test_it_reads_the_states_of_the_simulator(perception: str, tmp_path: Path) -> None:
    """Cells, altitude, heading and elevation with their signs, the order of the frames, the last action."""
    overrides = [*VALLEY, f"perception={perception}", "perception.last_action=true", "perception.lidar.max_range=6"]
    folder, settings = exported(tmp_path, *overrides), validate(compose("run_dir=here", *overrides))
    env = make_env(settings.env, settings.perception, tasks=[TASK], seed=settings.seed, num_uavs=1, keep_cloud=True)
    with closing(Wire(folder, env, TASK)) as wire:
        found, wanted, commands = flown(wire, env)
    terms, cells = wire.policy.contract.state, wire.policy.contract.cells.count
    assert found.shape == wanted.shape == (STEPS, terms.frames, cells + 7)
    np.testing.assert_allclose(found[..., cells:], wanted[..., cells:], rtol=0, atol=2e-5)
    # 4 mm; a ray on the border of two cells may come to lie in the other one, where a surface is a little nearer.
    assert np.quantile(np.abs(found[..., :cells] - wanted[..., :cells]), 0.95) < 1e-3
    assert np.ptp(wanted[..., cells:], axis=(0, 1)).min() > 0.0 and np.ptp(commands, axis=0).min() > 0.0
    env.close()


def test_it_sees_move_what_the_simulator_sees_move(tmp_path: Path) -> None:
    """By the packets' points, and the velocity and attitude of MAVLink, whose axes are others."""
    overrides = [*VALLEY, "perception=range_image", "perception.motion=12", "perception.lidar.max_range=12"]
    overrides += ["env.world.planes=4", "env.world.plane_keep_out=2"]
    folder, settings = exported(tmp_path, *overrides), validate(compose("run_dir=here", *overrides))
    env = make_env(settings.env, settings.perception, tasks=[TASK], seed=settings.seed, num_uavs=1, keep_cloud=True)
    with closing(Wire(folder, env, TASK)) as wire:
        found, wanted, _ = flown(wire, env)
    env.close()
    told, true = (each[:, -1, 75:96].reshape(STEPS, 3, 7) for each in (found, wanted))
    both = (told[..., 6] > 0) & (true[..., 6] > 0)
    assert both.sum() > 5 and ((told[..., 6] > 0) != (true[..., 6] > 0)).sum() <= 3
    apart = np.abs(told - true)[both]
    assert np.median(apart[:, :3]) < 0.01 and np.median(apart[:, 3:6]) < 0.05, "12 cm, 0.25 m/s"
    np.testing.assert_allclose(found[0], wanted[0], rtol=0, atol=0.02)


@pytest.mark.parametrize(("sensor", "sees"), [("vlp16", False), ("os0_32", True)])
@pytest.mark.parametrize("perception", ["range_image", "truncated_icosahedron"])
def test_on_board_it_reads_what_the_sensor_of_its_training_could_have_seen(
    perception: str, sensor: str, sees: bool, tmp_path: Path
) -> None:
    """A ceiling 2 m above, at 40 degrees, in the scan of any sensor; a wall ahead is seen by both."""
    folder = exported(tmp_path, f"perception={perception}", f"env.lidar={sensor}", "algo.hidden=[4]")
    policy = Policy(folder)
    for cloud, wanted in (([[2.4, 0.0, 2.0]], sees), ([[2.4, 0.0, 0.5]], True)):
        policy.state(np.array(cloud), altitude=3.5, heading_deg=0.0, elevation_deg=0.0)
        assert policy.cells is not None and policy.cells.any() == wanted
