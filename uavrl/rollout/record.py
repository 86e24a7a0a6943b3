"""Flies chosen tasks without noise and keeps every step."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv
from tqdm import tqdm

from uavrl.envs.mesh import Mesh
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World
from uavrl.errors import UavrlError
from uavrl.rollout.position_stats import PositionStats
from uavrl.rollout.recording import RecordedFlight, Recording, Scenery, thinned
from uavrl.rollout.rollout import FlightMeter, Policy, rollout
from uavrl.transforms import PointCloudReduction
from uavrl.transforms.rewards import terms_of

Risk = Callable[[Tensor, Tensor], Tensor]
_KEPT = ("position", "velocity", "distance", "clearance", "observation")


def make_scenery(world: World, valley: int, reduction: PointCloudReduction, sensor: Sequence[float]) -> Scenery:
    """The valley with an index, as numbers to draw."""
    place, config = world.valleys[valley], world.config
    names = tuple(sorted({obstacle.kind for obstacle in place.obstacles}))
    merged = Mesh.merge(obstacle.mesh for obstacle in place.obstacles)
    kinds = [np.full(len(obstacle.mesh.faces), names.index(obstacle.kind)) for obstacle in place.obstacles]
    plane = plane_mesh(config.plane_wingspan)
    return Scenery(
        heights=place.ground.heights,
        size=np.array(place.ground.size),
        vertices=merged.vertices,
        triangles=merged.faces,
        kinds=np.concatenate([np.zeros(0, dtype=int), *kinds]),
        kind_names=names,
        plane_vertices=plane.vertices,
        plane_triangles=plane.faces,
        goal=np.array([config.goal_radius, config.ceiling]),
        ball=reduction.radius,
        directions=reduction.directions().numpy(),
        statistic=reduction.statistic,
        sensor=np.array(sensor),
    )


def record_flight(
    env: TransformedEnv,
    policy: Policy,
    task: int,
    *,
    seed: int,
    risk: Risk | None = None,
    max_points: int = 1500,
) -> RecordedFlight:
    """Flies one task to its end, without exploration noise, and keeps every step.

    The traffic starts anew, so that the flight depends on ``seed`` and ``task`` alone.
    """
    if env.batch_size != torch.Size([1]):
        raise ValueError(f"Expected an environment of one vehicle, got {tuple(env.batch_size)}: pass num_uavs=1.")
    base = env.base_env
    assert isinstance(base, NavigationEnv)
    env.set_seed(seed)
    state = env.reset(task=task)
    goal = state["goal"][0].numpy()
    origins = np.stack([np.append(valley.origin, 0.0) for valley in base.world.valleys])
    valley = int(np.linalg.norm(origins - goal, axis=1).argmin())
    meter, reduction = FlightMeter(1), reduction_of(env)
    terms = terms_of(env) or (lambda before, after: {"reward": after["reward"]})
    moments, actions, paid = [_moment(base, state, valley, reduction, max_points)], [], []
    for stepped in rollout(env, policy, state):
        ended = meter.step(stepped)
        moments.append(_moment(base, stepped["next"], valley, reduction, max_points))
        actions.append(stepped["action"][0])
        paid.append({name: term.item() for name, term in terms(stepped, stepped["next"]).items()})
        if ended:
            break
    states = cast(TensorDict, torch.stack([moment["state"] for moment in moments]))
    taken, origin, places = torch.stack(actions), origins[valley], PositionStats(base.world)
    places.add(states["position"][1:].numpy())
    return RecordedFlight(
        summary=ended[0],
        whereabouts=places.summary(),
        times=np.arange(len(moments)) / CONTROL_RATE,
        positions=states["position"].numpy() - origin.astype(np.float32),
        attitudes=np.stack([moment["attitude"] for moment in moments]),
        velocities=states["velocity"].numpy(),
        goal=goal - origin,
        observations=states["observation"].numpy(),
        actions=taken.numpy(),
        rewards=np.array([list(terms.values()) for terms in paid], np.float32),
        reward_names=tuple(paid[0]),
        distances=states["distance"][:, 0].numpy(),
        clearances=states["clearance"][:, 0].numpy(),
        risks=np.zeros(0) if risk is None else risk(states["observation"][:-1], taken).numpy(),
        planes=np.stack([moment["planes"] for moment in moments]) - np.append(origin, 0.0),
        faces=np.stack([moment["cells"] for moment in moments]),
        points=np.concatenate([moment["points"] for moment in moments]).astype(np.float32),
        point_ends=np.cumsum([len(moment["points"]) for moment in moments]),
    )


def reduction_of(env: TransformedEnv) -> PointCloudReduction:
    """What reduces the scan.

    Raises:
        UavrlError: when nothing does whose scan and cells could be drawn.
    """
    found = next((part for part in env.transform.modules() if isinstance(part, PointCloudReduction)), None)
    if found is None:
        raise UavrlError(
            "A replay draws the cells of a uavrl.transforms.PointCloudReduction, and this perception has none: derive "
            "its reduction from that class, or see how it does with uavrl-evaluate."
        )
    kept = env.observation_spec.keys(True, True)
    if dropped := [key for key in (found.in_keys[0], found.out_keys[0]) if key not in kept]:
        raise UavrlError(
            f"A replay draws the scan and the cells of {type(found).__name__}, and this perception drops {dropped}: "
            f"let it keep them, by del_keys=False of what reads them, or see how it does with uavrl-evaluate."
        )
    return found


def _moment(
    base: NavigationEnv, state: TensorDictBase, valley: int, reduction: PointCloudReduction, max_points: int
) -> dict[str, Any]:
    """What is to be seen in one valley at one moment, in the world's frame."""
    cloud = state[reduction.in_keys[0]][0].numpy()
    planes = base.world.config.planes
    return {
        "state": state.select(*_KEPT)[0].clone(),
        "cells": state[reduction.out_keys[0]][0].numpy().copy(),
        "attitude": Rotation.from_matrix(base.simulation.rotation[0]).as_quat(),
        "planes": base.plane_poses()[valley * planes : (valley + 1) * planes],
        "points": thinned(cloud[np.isfinite(cloud).all(-1)], max_points),
    }


def record_flights(
    env: TransformedEnv,
    policy: Policy,
    tasks: Sequence[int],
    *,
    seed: int,
    source: dict[str, Any],
    risk: Risk | None = None,
    max_points: int = 1500,
    progress: bool = False,
) -> Recording:
    """Flies several tasks, each as :func:`record_flight` does."""
    if not tasks:
        raise ValueError("Expected at least one task to fly, got none.")
    flights = tuple(
        record_flight(env, policy, task, seed=seed, risk=risk, max_points=max_points)
        for task in tqdm(tasks, disable=not progress, unit="flight")
    )
    world, sensor = env.base_env.world, env.base_env.airframe.lidar_position
    seen = {flight.summary.world_seed for flight in flights}
    sceneries = {
        valley.seed: make_scenery(world, i, reduction_of(env), sensor)
        for i, valley in enumerate(world.valleys)
        if valley.seed in seen
    }
    return Recording(source, flights, sceneries)
