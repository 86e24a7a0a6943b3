"""Flies chosen tasks without noise and keeps every step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from omegaconf import DictConfig
from scipy.spatial.transform import Rotation
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.checkpoint import Checkpoint
from torchrl.envs import TransformedEnv, step_mdp
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from uavrl.configs.train import TrainConfig
from uavrl.envs.mesh import Mesh
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World
from uavrl.losses import LifeGuard
from uavrl.training.checkpoint import restore
from uavrl.training.evaluation import Flight, FlightRecorder, Policy
from uavrl.training.factory import make_env
from uavrl.training.flight import RecordedFlight, Replay, Scenery, thinned
from uavrl.training.learner import make_actor, make_loss
from uavrl.training.spaces import flat, spaces_of
from uavrl.training.whereabouts import Whereabouts

Risk = Callable[[Tensor, Tensor], Tensor]
Terms = Callable[[TensorDictBase, TensorDictBase], dict[str, Tensor]]
_SEEN = ("observation", "faces", "altitude", "heading_deg", "elevation_deg")
_KEPT = ("position", "velocity", "distance", "clearance", "arrived", "collided", *_SEEN)


def make_scenery(world: World, valley: int, perception: DictConfig, sensor: Sequence[float]) -> Scenery:
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
        ball=perception.radius,
        statistic=perception.statistic,
        sensor=np.array(sensor),
    )


@torch.no_grad()
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

    Args:
        env: One navigation environment (``num_uavs=1``) that keeps its ``point_cloud`` and emits ``clearance``.
        policy: Reads the environment's output, writes ``action``.
        task: Number of the task, from 0.
        seed: Seed of the tasks.
        risk: From observations ``[*B, W]`` and actions ``[*B, 4]`` to probabilities of a collision ``[*B]``.
        max_points: Points kept of each scan.

    Raises:
        ValueError: For an environment of more than one vehicle.
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
    recorder = FlightRecorder(1)
    moments, steps = [_moment(base, state, valley, max_points)], []
    ended: list[Flight] = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        while not ended:
            stepped = env.step(policy(state))
            ended = recorder.step(stepped, stepped["next"])
            moments.append(_moment(base, stepped["next"], valley, max_points))
            steps.append(TensorDict({"action": stepped["action"][0], "reward": stepped["next", "reward"][0]}))
            state = step_mdp(stepped)
    return _recorded(ended[0], base.world, moments, steps, origins[valley], goal, _terms_of(env), risk)


def _terms_of(env: TransformedEnv) -> Terms | None:
    """What splits the environment's reward into named terms, where its transform can."""
    return next((transform.terms for transform in flat(env.transform) if hasattr(transform, "terms")), None)


def _moment(base: NavigationEnv, state: TensorDictBase, valley: int, max_points: int) -> dict[str, Any]:
    """What is to be seen in one valley at one moment, in the world's frame."""
    cloud = state["point_cloud"][0].numpy()
    planes = base.world.config.planes
    return {
        "state": state.select(*_KEPT)[0].clone(),
        "attitude": Rotation.from_matrix(base.simulation.rotation[0]).as_quat(),
        "planes": base.plane_poses()[valley * planes : (valley + 1) * planes],
        "points": thinned(cloud[np.isfinite(cloud).all(-1)], max_points),
    }


def _recorded(
    summary: Flight,
    world: World,
    moments: list[dict[str, Any]],
    taken: list[TensorDict],
    origin: np.ndarray,
    goal: np.ndarray,
    terms_of: Terms | None,
    risk: Risk | None,
) -> RecordedFlight:
    states = cast(TensorDict, torch.stack([moment["state"] for moment in moments]))
    steps = cast(TensorDict, torch.stack(cast(list[Tensor], taken)))
    terms = {"reward": steps["reward"][:, 0]} if terms_of is None else terms_of(states[:-1], states[1:])
    planes = np.stack([moment["planes"] for moment in moments])
    places = Whereabouts(world)
    places.add(states["position"][1:].numpy())
    return RecordedFlight(
        summary=summary,
        whereabouts=places.summary(),
        times=np.arange(len(moments)) / CONTROL_RATE,
        positions=states["position"].numpy() - origin.astype(np.float32),
        attitudes=np.stack([moment["attitude"] for moment in moments]),
        velocities=states["velocity"].numpy(),
        goal=goal - origin,
        observations=states["observation"].numpy(),
        actions=steps["action"].numpy(),
        rewards=torch.stack(list(terms.values()), -1).numpy(),
        reward_names=tuple(terms),
        distances=states["distance"][:, 0].numpy(),
        clearances=states["clearance"][:, 0].numpy(),
        risks=np.zeros(0) if risk is None else risk(states["observation"][:-1], steps["action"]).numpy(),
        planes=planes - np.append(origin, 0.0),
        faces=states["faces"].numpy(),
        points=np.concatenate([moment["points"] for moment in moments]).astype(np.float32),
        point_ends=np.cumsum([len(moment["points"]) for moment in moments]),
    )


def load_risk(config: TrainConfig, checkpoint: Path, device: torch.device) -> Risk | None:
    """What the LifeGuard of a run has learned, or None where the run has none.

    Args:
        config: The run's settings.
        checkpoint: A checkpoint that was found good.
        device: Where to compute.

    Returns:
        From observations ``[*B, W]`` and actions ``[*B, 4]`` to probabilities of a collision ``[*B]``.

    Raises:
        UavrlError: When the checkpoint holds another LifeGuard than the configuration.
    """
    if config.lifeguard._target_ is None:
        return None
    env = make_env(config.env, config.perception, packages=config.packages, num_uavs=1)
    spaces = spaces_of(env)
    env.close()
    loss = make_loss(config, make_actor(config, spaces, device), spaces, device)
    restore(Checkpoint(loss_module=loss), checkpoint, ["loss_module"])
    guard = next((part for part in getattr(loss, "enhancers", []) if isinstance(part, LifeGuard)), None)
    if guard is None:
        return None

    def risk(observations: Tensor, actions: Tensor) -> Tensor:
        features = torch.cat([observations[..., -guard.observations :], actions], -1).to(device)
        with torch.no_grad():
            return guard.classifier(guard.scaler(features)).sigmoid().cpu()

    return risk


def record_flights(
    env_config: DictConfig,
    perception: DictConfig,
    policy: Policy,
    tasks: Sequence[int],
    *,
    seed: int,
    source: dict[str, Any],
    reward: DictConfig | None = None,
    packages: Iterable[str] = (),
    risk: Risk | None = None,
    max_points: int = 1500,
    progress: bool = False,
) -> Replay:
    """Flies several tasks, each as :func:`record_flight` does.

    Args:
        env_config: The task.
        perception: What the policy sees.
        policy: Reads the environment's output, writes ``action``.
        tasks: Numbers of the tasks, from 0.
        seed: Seed of the tasks.
        source: Kept with the flights, for a heading.
        reward: What pays; its terms are kept.
        packages: Packages whose classes may be named.
        risk: From observations ``[*B, W]`` and actions ``[*B, 4]`` to probabilities of a collision ``[*B]``.
        max_points: Points kept of each scan.
        progress: Show a progress line.

    Raises:
        ValueError: Without tasks.
    """
    if not tasks:
        raise ValueError("Expected at least one task to fly, got none.")
    env = make_env(
        env_config,
        perception,
        reward,
        packages=packages,
        seed=seed,
        num_uavs=1,
        measure_clearance=True,
        keep_cloud=True,
    )
    try:
        flights = tuple(
            record_flight(env, policy, task, seed=seed, risk=risk, max_points=max_points)
            for task in tqdm(tasks, disable=not progress, unit="flight")
        )
        world = env.base_env.world
        seen = {flight.summary.world_seed for flight in flights}
        sceneries = {
            valley.seed: make_scenery(world, i, perception, env.base_env.airframe.lidar_position)
            for i, valley in enumerate(world.valleys)
            if valley.seed in seen
        }
    finally:
        env.close()
    return Replay(source, flights, sceneries)
