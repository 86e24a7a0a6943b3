"""Flights among planes, step by step: what is seen with and without the planes, and when and where one passes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import step_mdp

from uavrl.config import TrainConfig, compose, validate
from uavrl.envs import NavigationEnv
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.overrides import with_overrides
from uavrl.transforms import PointCloudReduction
from uavrl_onboard.perception.motion import OBJECT

VEHICLES, SEED = 16, 20_000
FRAMES = 3  # of the history that is kept of points and planes
BESIDE, ABOVE = 1.1, 0.6  # m between the two middles within which a pass is a danger
NEAR_ENOUGH = 1.0  # m between a plane and what is reported as one
TIMES = (0.05, 0.3, 0.6, 0.9, 1.3, 2.0)  # s, the ends of the spans that are told apart


class Moment(NamedTuple):
    """One step of N vehicles."""

    seen: Tensor  # [N, frames, numbers], what the policy reads, each frame's cells first
    hidden: Tensor  # likewise, the same without the planes
    acted: Tensor  # [N, 4]
    time: np.ndarray  # [N], s until the nearest plane passes
    miss: np.ndarray  # [N, 3], where it passes from the vehicle: m forward, left, up
    points: np.ndarray  # [N, 3, 7], what on_planes() tells, now and at the two steps before
    plane: np.ndarray  # [N, 3, 3], where it is, and was at the two steps before
    danger: np.ndarray  # [N], whether it is seen and passes within reach
    told: np.ndarray  # [N, 3], where it would pass by what is reported of it as a moving object; NaN where nothing is


def among_planes(folder: Path, *overrides: str) -> tuple[TrainConfig, Callable[[TensorDictBase], TensorDictBase]]:
    """The configuration of a run or a packaged policy, among planes and with what is changed, and the policy."""
    policy = read_policy(folder)
    told = ["env=dynamic", *overrides]
    return validate(with_overrides(policy.config, compose(*told, name="evaluate"), told)), policy


def scan(base: NavigationEnv, planes: np.ndarray | None) -> np.ndarray:
    """What the LiDAR sees now, ``[N, 28928, 3]`` in the sensor frame, with planes at some poses or with none."""
    simulation, lidar = base.simulation, base._lidar
    assert lidar is not None
    return lidar.scan(simulation.lidar_position, simulation.rotation, planes, rng=np.random.default_rng(0))


def on_planes(points: np.ndarray, without: np.ndarray) -> np.ndarray:
    """Of the points ``[N, P, 3]`` that a scan has and one without planes has not: their mean, the nearest, how many.

    ``[N, 7]``, the last in hundreds; 0 where there are none.
    """
    told = np.zeros((len(points), 7), np.float32)
    for row, (these, those) in enumerate(zip(points, without, strict=True)):
        new = these[np.isfinite(these[:, 0]) & (these[:, 0] != those[:, 0])]
        if len(new):
            told[row] = (*new.mean(0), *new[np.linalg.norm(new, axis=1).argmin()], len(new) / 100)
    return told


def ahead(vectors: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Vectors ``[N, ..., 3]`` of the world as forward, left and up of vehicles with these yaws ``[N]``."""
    cosine, sine = (part.reshape(-1, *[1] * (vectors.ndim - 2)) for part in (np.cos(yaw), np.sin(yaw)))
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x * cosine + y * sine, y * cosine - x * sine, z], -1)


def reported(state: TensorDictBase, plane: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Where planes at ``plane [N, 3]`` will pass by the moving object reported there, ``[N, 3]``, NaN without one.

    Args:
        state: what the environment emits; without moving objects nothing is reported.
        plane: forward, left and up of the vehicles in m.
        velocity: of the vehicles in m/s, likewise.
    """
    if "moving_objects" not in state:
        return np.full(plane.shape, np.nan)
    objects = state["moving_objects"].unflatten(-1, (-1, len(OBJECT))).numpy()
    apart = np.linalg.norm(objects[..., :3] - plane[:, None], axis=-1)
    nearest = apart.argmin(1)
    mine = objects[np.arange(len(objects)), nearest]
    _, miss = passes(mine[:, :3], mine[:, 3:6] - velocity)
    return np.where((apart.min(1) < NEAR_ENOUGH)[:, None] & (mine[:, -1:] > 0), miss, np.nan)


def passes(offset: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When what is at an offset with a relative velocity ``[N, 3]`` comes nearest, in s, and where it is then."""
    time = np.clip(-(offset * velocity).sum(1) / ((velocity**2).sum(1) + 1e-9), 0.0, 3.0)
    return time, offset + time[:, None] * velocity


@torch.no_grad()
def moments(config: TrainConfig, policy: Callable[[TensorDictBase], TensorDictBase], steps: int) -> Iterator[Moment]:
    """Flies a policy; every scan is taken twice, with and without the planes."""
    env = make_env(config.env, config.perception, config.reward, seed=SEED, num_uavs=VEHICLES)
    base = env.base_env
    reduction = next(part for part in env.transform.modules() if isinstance(part, PointCloudReduction))
    assert isinstance(base, NavigationEnv)
    cells, shape = len(reduction.directions()), (config.perception.frames, -1)
    state, every = env.reset(), np.arange(VEHICLES)
    hidden = state["observation"].unflatten(-1, shape).clone()
    planes = [base.plane_poses()[:, :3]] * FRAMES  # the newest first
    places = [base.simulation.position] * FRAMES
    points = [np.zeros((VEHICLES, 7), np.float32)] * FRAMES
    for _ in range(steps):
        seen = state["observation"].unflatten(-1, shape)
        without = scan(base, None)
        cloud = torch.as_tensor(np.ascontiguousarray(without))
        hidden[:, -1, :cells] = reduction.reduced(cloud, reduction.radius, reduction.statistic) / reduction.radius
        points = [on_planes(scan(base, base.plane_poses()), without), *points[: FRAMES - 1]]
        shown = ((seen - hidden)[:, -1, :cells].abs() > 0.05).any(-1).numpy()
        sight = state.copy()
        state = policy(state)
        offsets = np.stack([p[None] - q[:, None] for p, q in zip(planes, places, strict=True)], 2)  # [N, P, 3, 3]
        nearest = np.linalg.norm(offsets[:, :, 0], axis=-1).argmin(1)
        yaw, velocity = base.simulation.yaw, (planes[0] - planes[1]) * 10  # m/s, over the last 0.1 s
        time, miss = passes(offsets[every, nearest, 0], velocity[nearest] - base.simulation.velocity)
        miss = ahead(miss, yaw)
        plane = ahead(offsets[every, nearest], yaw)
        told = reported(sight, plane[:, 0], ahead(base.simulation.velocity, yaw))
        shown |= np.isfinite(told[:, 0])
        danger = shown & (np.hypot(miss[:, 0], miss[:, 1]) < BESIDE) & (np.abs(miss[:, 2]) < ABOVE)
        yield Moment(seen, hidden.clone(), state["action"], time, miss, np.stack(points, 1), plane, danger, told)
        state = env.step(state)
        ended = state["next", "done"]
        state = step_mdp(state)
        if ended.any():
            state = env.reset(state.set("_reset", ended))
        now = state["observation"].unflatten(-1, shape)
        hidden = torch.where(ended[..., None], now, torch.cat([hidden[:, 1:], now[:, -1:]], 1))
        planes = [base.plane_poses()[:, :3], *planes[:-1]]
        places = [base.simulation.position, *places[:-1]]
    env.close()
