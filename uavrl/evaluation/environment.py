"""The environment of a configuration."""

import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, EnvBase, InitTracker, TensorDictPrimer, Transform, TransformedEnv

from uavrl.config.build import TARGET, arguments, build, find_class
from uavrl.config.context import CONTEXT
from uavrl.envs.guarding import far_seeing, guarded, looks_around
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.privileged import QUANTITIES
from uavrl.errors import UavrlError
from uavrl.models.memory import RECURRENT_STATE
from uavrl.transforms import PointCloudReduction
from uavrl.transforms.composition import inner_transforms
from uavrl.transforms.guarded import GOAL_HEADING
from uavrl.transforms.privileged import Privileged
from uavrl_onboard.guards.settings import GuardSettings

log = logging.getLogger(__name__)

FAR_RANGE = "perception.lidar.far_range"


def make_env(
    env: Mapping[str, Any],
    perception: Mapping[str, Any],
    reward: Mapping[str, Any] | None = None,
    *,
    packages: Iterable[str] = (),
    num_uavs: int | None = None,
    keep_cloud: bool = False,
    mark_resets: bool = False,
    recurrent_state: tuple[int, ...] | None = None,
    critic_reads: Sequence[str] = (),
    policy_reads: Iterable[Any] = (),
    guards: GuardSettings | None = None,
    kind: type[TransformedEnv] = TransformedEnv,
    **context: Any,
) -> TransformedEnv:
    """The environment with everything between what it emits and what the policy and the learner read.

    ``keep_cloud`` keeps the point clouds, ``mark_resets`` emits ``is_init``, whether an episode begins. A
    ``recurrent_state`` of this shape is carried from step to step, for a policy with a memory. What ``critic_reads``
    names is emitted as ``privileged``; what only a simulator knows of ``policy_reads``, the keys that a policy or a
    demonstrator reads, is emitted by its name. ``guards`` are put between the policy and the environment.
    """
    perception = with_sight(perception, guards)
    several = {} if num_uavs is None else {"num_uavs": num_uavs}  # in place of the run's
    seen = {key: value for key, value in perception.items() if key not in CONTEXT["env"]}
    settings = {**seen, **env, **several}
    asked = [key for key in QUANTITIES if key in (*critic_reads, *policy_reads)]
    context |= {"privileged": asked} if asked else {}
    base = build(settings, EnvBase, packages=packages, key="env", **context)
    if base is None:
        raise UavrlError("env must name an environment, got null: choose one with env=NAME.")
    made = kind(base, Compose())
    position = getattr(env.get("airframe"), "lidar_position", None)  # somebody else's airframe may have none
    mounted = {} if position is None else {"sensor_position": position}
    state = build(perception, Transform, packages=packages, **mounted)
    if guards is not None and guards.names:
        limit = getattr(state, "max_speed", None)  # of a trained policy that of its training
        reward = _guard(made, reward, guards, packages, limit)
    for part in () if state is None else state.modules():
        if isinstance(part, PointCloudReduction):
            part.view = getattr(perception.get("lidar"), "trained_view", None)
            part.del_keys = part.del_keys and not keep_cloud
    paid = None if reward is None else build(reward, Transform, packages=packages)
    for transform, part in ((state, "perception"), (paid, "reward")):
        if transform is not None:
            require_keys(made, [(inner.in_keys, inner.out_keys) for inner in inner_transforms(transform)], part)
            made.append_transform(transform)
    require_keys(made, [(["observation"], [])], "policy")
    if critic_reads:
        require_keys(made, [(critic_reads, [])], "critic", before_acting=True)
        made.append_transform(
            Privileged(critic_reads, {key: QUANTITIES[key].divisor for key in asked if key in critic_reads})
        )
    if mark_resets or recurrent_state is not None:
        made.append_transform(InitTracker())
    if recurrent_state is not None:
        spec = Unbounded(recurrent_state, dtype=torch.float32)
        made.append_transform(TensorDictPrimer({RECURRENT_STATE: spec}, expand_specs=True))
    return made


def _guard(
    made: TransformedEnv,
    reward: Mapping[str, Any] | None,
    guards: GuardSettings,
    packages: Iterable[str],
    max_speed: float | None,
) -> Mapping[str, Any] | None:
    """Put guards before all transforms; return the reward, which reads the heading to the goal itself."""
    if not isinstance(made.base_env, NavigationEnv):
        raise UavrlError(
            f"Guards read the scans of a valley, and {type(made.base_env).__name__} is none: choose guards=none."
        )
    around = guarded(made.base_env, guards, max_speed)
    made.append_transform(around)
    if reward is None or reward[TARGET] is None or not around.leads:
        return reward
    taken = arguments(find_class(str(reward[TARGET]), Transform, packages))
    return {"heading": GOAL_HEADING, **reward} if "heading" in taken else reward


def with_sight(
    perception: Mapping[str, Any], guards: GuardSettings | None = None, given: Collection[str] = (FAR_RANGE,)
) -> Mapping[str, Any]:
    """Let the LiDAR reach as far as perception and guards look: nothing else changes its ``far_range``.

    A ``far_range`` among the ``given`` keys stays. Any other grows if guards look farther.
    """
    lidar, motion = perception.get("lidar"), perception.get("motion")
    motion = motion if isinstance(motion, int | float) else None  # somebody else's perception may mean something else
    sight = None if guards is None else guards.sight
    if lidar is None or (motion is None and sight is None):
        return perception
    stays = FAR_RANGE in given
    recorded = None if stays else lidar.far_range
    scanning = far_seeing(lidar if stays else replace(lidar, far_range=None), recorded, motion, sight)
    if motion is not None and motion > scanning.farthest:
        raise UavrlError(
            f"perception.motion={motion:g} looks farther than the LiDAR, which reaches {scanning.farthest:g} m: leave "
            f"{FAR_RANGE} out, choose another env.lidar, or lower perception.motion."
        )
    if motion is not None and not looks_around(lidar.device):
        log.warning(
            "The LiDAR %s does not see the same elevations on all sides, so static obstacles seem to move when it "
            "turns: choose another env.lidar for perception.motion.",
            lidar.device.name,
        )
    return perception if scanning.far_range == lidar.far_range else {**perception, "lidar": scanning}


def require_keys(
    env: EnvBase, steps: Iterable[tuple[Iterable[Any], Iterable[Any]]], reader: str, *, before_acting: bool = False
) -> None:
    """Refuses what reads more than an environment emits, each step also what the steps before it have written.

    ``before_acting`` leaves out actions, rewards and ends, of which an observation knows nothing.
    """
    specs: tuple[Composite, ...] = (env.observation_spec,)
    if not before_acting:
        specs += (env.full_reward_spec, env.full_done_spec, env.full_action_spec)
    emitted = {key for spec in specs for key in spec.keys(True, True)}
    for read, written in steps:
        for key in read:
            if key not in emitted:
                raise UavrlError(
                    f"The {reader} reads {key!r}, which {type(env.base_env).__name__} does not emit, or which its "
                    f"perception has taken: choose an env, a perception and a reward that go together."
                )
        emitted.update(written)


def make_device(name: str) -> torch.device:
    """Turns ``auto``, ``cpu`` or ``cuda[:i]`` into a device that exists."""
    if name == "auto":
        return torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        device = torch.device("meta")  # refused as any other that is no processor
    if device.type not in ("cpu", "cuda"):
        raise UavrlError(f"device must be auto, cpu, cuda or cuda:<index>, got {name!r}.")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise UavrlError(
            f"device={name} was asked for and this machine has {torch.cuda.device_count()} CUDA devices: "
            f"use device=cpu."
        )
    return device
