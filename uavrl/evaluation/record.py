"""Rolls out a policy in chosen tasks without noise and keeps every step."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from uavrl.envs.mesh import decimated
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.rules import Solid, Standing
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World
from uavrl.errors import UavrlError
from uavrl.evaluation.position_stats import PositionStats
from uavrl.evaluation.recording import RecordedFlight, Recording, Scenery, thinned
from uavrl.evaluation.rollout import EpisodeMeter, rollout, speed_limit
from uavrl.policy_protocol import Acts
from uavrl.runs.progress_line import ProgressLine
from uavrl.transforms import PointCloudReduction
from uavrl.transforms.guarded import FLOWN, GOAL_HEADING
from uavrl.transforms.rewards import terms_of
from uavrl_onboard.geometry import is_return, yaw_rotation
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.perception.motion import OBJECT

Risk = Callable[[Tensor, Tensor], Tensor]
MOST_TRIANGLES = 200_000  # of each thing that stands in a place, in a picture
NONE = np.zeros((0, len(OBJECT)), np.float32)
_KEPT = ("position", "velocity", "distance", "clearance", "observation")


def make_scenery(world: World, number: int, reduction: PointCloudReduction, sensor: Sequence[float]) -> Scenery:
    """The place with an index, as numbers to draw."""
    place, config = world.places[number], world.config
    shown = [_shown(obstacle, config.ceiling, place.ground is None) for obstacle in place.obstacles]
    names = tuple(sorted({obstacle.kind for obstacle in shown}))
    merged = Mesh.merge(obstacle.mesh for obstacle in shown)
    kinds = [np.full(len(obstacle.mesh.faces), names.index(obstacle.kind)) for obstacle in shown]
    plane = plane_mesh(config.plane_wingspan)
    return Scenery(
        heights=np.zeros((0, 0)) if place.ground is None else place.ground.heights,
        size=np.array(place.floor.size),
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


def _shown(standing: Standing, ceiling: float, is_ground: bool) -> Solid:
    """What a picture shows of something: nothing that lies over the ceiling and would hide what is below it."""
    mesh = standing.mesh
    if is_ground or standing.kind == "ceiling":
        lowest = mesh.vertices[mesh.faces][..., 2].min(1)
        mesh = Mesh(mesh.vertices, mesh.faces[lowest < ceiling])
    return Solid(standing.kind, decimated(mesh, MOST_TRIANGLES))


def record_flight(
    env: TransformedEnv, policy: Acts, task: int, *, seed: int, risk: Risk | None = None, max_points: int = 1500
) -> RecordedFlight:
    """Rolls out one task to its end and keeps every step; the episode depends on ``seed`` and ``task`` alone."""
    if env.batch_size != torch.Size([1]):
        raise ValueError(f"Expected an environment of one vehicle, got {tuple(env.batch_size)}: pass num_uavs=1.")
    base = env.base_env
    assert isinstance(base, NavigationEnv)
    env.set_seed(seed)
    state = env.reset(task=task)
    goal = state["goal"][0].numpy()
    origins = np.stack([np.append(valley.origin, 0.0) for valley in base.world.places])
    valley = int(np.linalg.norm(origins - goal, axis=1).argmin())
    meter, reduction = EpisodeMeter(1, speed_limit(env)), reduction_of(env)
    terms = terms_of(env) or (lambda before, after: {"reward": after["reward"]})
    moments, actions, paid = [_moment(base, state, valley, reduction, max_points)], [], []
    for stepped in rollout(env, policy, state):
        ended = meter.step(stepped)
        moments.append(_moment(base, stepped["next"], valley, reduction, max_points))
        actions.append(stepped["next"].get(FLOWN, stepped["action"])[0])
        paid.append({name: term.item() for name, term in terms(stepped, stepped["next"]).items()})
        if ended:
            break
    states = cast(TensorDict, torch.stack([moment["state"] for moment in moments]))
    taken, origin, places = torch.stack(actions), origins[valley], PositionStats(base.world)
    places.add(states["position"][1:].numpy())
    return RecordedFlight(
        summary=ended[0],
        position_stats=places.summary(),
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
        objects=np.stack([moment["objects"] for moment in moments]) - np.append(origin, np.zeros(4)),
        bearings=np.array([moment["bearing"] for moment in moments if moment["bearing"] is not None]),
    )


def reduction_of(env: TransformedEnv) -> PointCloudReduction:
    """What reduces the scan; refuses a perception whose scan or cells could not be drawn."""
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
    """One moment in one valley, in the world's frame."""
    cloud = state[reduction.in_keys[0]][0].numpy()
    planes = base.world.config.planes
    yaw, led = state["attitude"][0, 2].item(), GOAL_HEADING in state
    seen = state["moving_objects"][0].unflatten(-1, (-1, len(OBJECT))).numpy() if "moving_objects" in state else NONE
    return {
        "state": state.select(*_KEPT)[0].clone(),
        "cells": state[reduction.out_keys[0]][0].numpy().copy(),
        "attitude": Rotation.from_matrix(base.simulation.rotation[0]).as_quat(),
        "planes": base.plane_poses()[valley * planes : (valley + 1) * planes],
        "points": thinned(cloud[is_return(cloud)], max_points),
        "objects": to_world(seen, base.simulation.lidar_position[0], yaw),
        "bearing": yaw + np.deg2rad(state["heading_deg"].item()) if led else None,
    }


def to_world(objects: np.ndarray, sensor: np.ndarray, yaw: float) -> np.ndarray:
    """Moving objects ``[K, 7]`` that a sensor sees, in the world's axes, not the yaw's, and from its origin.

    Examples:
        >>> to_world(np.array([[2.0, 0, 0, 0, 3, 0, 1]]), np.array([5.0, 5, 3]), np.pi / 2).round(6).tolist()
        [[5.0, 7.0, 3.0, -3.0, 0.0, 0.0, 1.0]]
    """
    turn = yaw_rotation(yaw).T
    return np.concatenate([objects[:, :3] @ turn + sensor, objects[:, 3:6] @ turn, objects[:, 6:]], 1)


def record_flights(
    env: TransformedEnv,
    policy: Acts,
    tasks: Sequence[int],
    *,
    seed: int,
    source: dict[str, Any],
    risk: Risk | None = None,
    max_points: int = 1500,
    progress: bool = False,
) -> Recording:
    """Rolls out several tasks, each as :func:`record_flight` does."""
    if not tasks:
        raise ValueError("Expected at least one task, got none.")
    recorded = []
    with ProgressLine(len(tasks), "episodes", enabled=progress) as line:
        for task in tasks:
            recorded.append(record_flight(env, policy, task, seed=seed, risk=risk, max_points=max_points))
            line.add()
    flights = tuple(recorded)
    world, sensor = env.base_env.world, env.base_env.airframe.lidar_position
    seen = {flight.summary.world_seed for flight in flights}
    sceneries = {
        valley.seed: make_scenery(world, i, reduction_of(env), sensor)
        for i, valley in enumerate(world.places)
        if valley.seed in seen
    }
    return Recording(source, flights, sceneries)
