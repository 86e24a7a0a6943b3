"""A policy and the environment in which an evaluation or a replay runs it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from uavrl.config import TrainConfig, validate
from uavrl.config.build import TARGET
from uavrl.config.parts import Part
from uavrl.config.settings import EvaluateConfig, FlyingConfig
from uavrl.envs.sensors import SENSORS, LidarSensor, sensor_of_view
from uavrl.errors import UavrlError
from uavrl.evaluation.overrides import keys_of, require_sensor_alone, require_valley, with_overrides
from uavrl.evaluation.policies import default_guards, named_policy
from uavrl.evaluation.worlds import TRAINING, UNSEEN, unseen_seeds, without_variety
from uavrl.runs.labels import label
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.policy.contract import read_contract

if TYPE_CHECKING:
    import torch
    from torchrl.envs import EnvBase

    from uavrl.policy_protocol import TensorDictPolicy

SENSOR = "perception.lidar.sensor"


@dataclass(frozen=True)
class PolicySetup:
    """A policy, and the parts of the environment in which it is run."""

    policy: TensorDictPolicy
    env: Part
    perception: Part
    reward: Part
    choices: Mapping[str, str]  # the name of each part's yaml file
    source: dict[str, Any]  # the facts about the policy that a result contains
    run: TrainConfig | None = None  # its configuration with the changes of the command line; None for a baseline
    guards: GuardSettings = field(default_factory=GuardSettings)  # guards between the policy and the environment

    @property
    def env_options(self) -> dict[str, Any]:
        """The options of :func:`~uavrl.evaluation.environment.make_env` for the guards and the policy's ``in_keys``."""
        read = self.policy.in_keys
        return {
            "keep_cloud": "point_cloud" in read,
            "mark_resets": "is_init" in read,
            "recurrent_state": self.policy.recurrent_state,
            "guards": self.guards,
            "policy_reads": read,
        }


def choose(
    settings: FlyingConfig, config: DictConfig, overrides: list[str], folder: Path | None, device: torch.device
) -> PolicySetup:
    """Load the policy that a command line asks for, and return it with its environment."""
    from uavrl.evaluation.actor import read_policy

    if "env.num_uavs" in keys_of(overrides):
        instead = "write num_uavs=N" if isinstance(settings, EvaluateConfig) else "a replay flies one vehicle"
        raise UavrlError(f"env.num_uavs is set by the command itself: leave it out, {instead}.")
    if folder is None:
        require_valley(settings.env, settings.choices, "policy")
        context = {**settings.perception, "flight_level": settings.env.world.flight_level}
        context["airframe"] = settings.env.get("airframe")
        policy = named_policy(str(settings.policy), context, settings.packages, settings.vecnormalize)
        settings = _as_contracted(policy, settings, config, overrides)
        parts = (settings.env, settings.perception, settings.reward, settings.choices)
        chosen = PolicySetup(policy, *parts, {"policy": settings.policy})
    else:
        policy = read_policy(folder, settings.checkpoint, device, settings.packages)
        changed = with_overrides(policy.config, config, overrides)
        if settings.valleys != TRAINING:
            changed = without_variety(changed, config, keys_of(overrides))
        run = validate(changed)
        chosen = PolicySetup(policy, run.env, run.perception, run.reward, run.choices, dict(policy.source), run)
        behind = f" behind {'-'.join(names)}" if (names := guard_settings(run.guards).names) else ""
        chosen.source["label"] = f"{label(run.choices)}{behind}, seed {run.seed}"
        trained, flown = policy.config.env.get("world"), changed.env.get("world")
        if trained is not None and flown is not None and trained.get(TARGET) == flown.get(TARGET):
            chosen.source["training_valleys"] = list(trained.seeds)
    chosen = _in_view(chosen, settings, policy)
    _choose_valleys(chosen, settings, keys_of(overrides))
    return _guarded(chosen, settings, keys_of(overrides), default_guards(folder, policy))


def _choose_valleys(chosen: PolicySetup, settings: FlyingConfig, given: Collection[str]) -> None:
    """Set the valleys that the command line asks for; by default, those that the training did not use."""
    foreign = chosen.run is not None and "training_valleys" not in chosen.source
    if settings.valleys == TRAINING and foreign and "world" in chosen.env and chosen.env.world.VARIES:
        raise UavrlError(
            f"valleys=training asks for the worlds of the training, and env={chosen.choices.get('env')} is of another "
            "kind: leave valleys out, or give a list of seeds."
        )
    if settings.valleys == TRAINING or (settings.valleys == UNSEEN and "env.world.seeds" in given):
        return
    if settings.valleys != UNSEEN:
        require_valley(chosen.env, chosen.choices, "valleys")
    if "world" in chosen.env and (chosen.env.world.VARIES or settings.valleys != UNSEEN):
        unseen = unseen_seeds(chosen.source.get("training_valleys", ()))
        seeds = unseen if settings.valleys == UNSEEN else settings.valleys
        chosen.env["world"] = replace(chosen.env.world, seeds=seeds)


def _in_view(chosen: PolicySetup, settings: FlyingConfig, policy: TensorDictPolicy) -> PolicySetup:
    """Check that the LiDAR sees the policy's cells, and add another LiDAR than that of the training to the source."""
    from uavrl.evaluation.field_of_view import TRAINED_WITH, check_field_of_view, trained_sensor, with_trained_view

    if (lidar := chosen.perception.get("lidar")) is None:
        return chosen
    trained_with = None
    if chosen.run is not None:
        trained_with = trained_sensor(policy.config)  # type: ignore[attr-defined]  # of a run it is a LoadedPolicy
    elif policy.overrides is not None:
        trained_with = policy.overrides.get(SENSOR, TRAINED_WITH)
        if trained_with not in SENSORS:
            trained_with = _own_sensor(trained_with, lidar.device, settings)
    allowed = settings.allow_unseen
    unseen = check_field_of_view(chosen.perception, trained_with, settings.packages, allowed=allowed)
    perception = Part(with_trained_view(chosen.perception, trained_with, settings.packages))
    if lidar.device == replace(lidar, sensor=trained_with or TRAINED_WITH).device == SENSORS[TRAINED_WITH]:
        return replace(chosen, perception=perception)
    source = {**chosen.source, "lidar": lidar.device.name, "unseen_cells": unseen}
    return replace(chosen, source=source, perception=perception)


def _own_sensor(name: str, flown: LidarSensor, settings: FlyingConfig) -> LidarSensor:
    """Return what is known of the LiDAR of one's own that a policy was trained with.

    That is the LiDAR that flies if it has its name and its field of view, and else one that sees all of this.
    """
    folder = Path(str(settings.policy)).expanduser()
    if flown.name != name and not settings.allow_unseen:
        kept = f"write run={settings.policy}, which has them, " if (folder / "config.yaml").is_file() else ""
        raise UavrlError(
            f"{settings.policy} was trained with {name}, a LiDAR of its own, whose rays are not in its contract: "
            f"{kept}name the YAML file that describes it with env.lidar=FILE.yaml, or fly with {flown.name} "
            "nevertheless with allow_unseen=true."
        )
    lidar = read_contract(folder).cloud.lidar
    assert lidar is not None, "else the policy was trained with a VLP-16"
    same = (flown.name, flown.field_of_view, flown.repeats) == (name, lidar.field_of_view, lidar.repeats)
    return flown if same else sensor_of_view(name, lidar.field_of_view)


def _guarded(
    chosen: PolicySetup, settings: FlyingConfig, given: Collection[str], default: GuardSettings
) -> PolicySetup:
    """Add the guards that the command line asks for; by default, those of the policy."""
    from uavrl.evaluation.environment import with_sight

    valley = "world" in chosen.env
    guards = guard_settings(settings.guards, default if valley else GuardSettings())
    if not guards.names:
        return chosen
    require_valley(chosen.env, chosen.choices, "guards")
    if guards.map is not None and chosen.policy.has_map:
        raise UavrlError(
            f"policy={chosen.source['policy']} has a map of its own, which contradicts the map among its guards: write "
            "guards=[evasion,shield], or choose another policy."
        )
    about = {**chosen.source, "guards": guards.plain()}
    perception = with_sight(chosen.perception, guards, given)
    return replace(chosen, guards=guards, source=about, perception=Part(perception))


def _as_contracted(
    policy: TensorDictPolicy, settings: FlyingConfig, config: DictConfig, overrides: list[str]
) -> FlyingConfig:
    """Return the settings with the perception and the sensor of an exported policy; unchanged for any other."""
    if policy.overrides is None:
        return settings
    config = config.copy()
    given = keys_of(overrides)
    require_sensor_alone(given, ("perception",), "policy")
    for key, value in policy.overrides.items():
        own_sensor = key == SENSOR and value not in SENSORS
        if key not in given and not own_sensor and OmegaConf.select(config, key.rpartition(".")[0]) is not None:
            OmegaConf.update(config, key, value, merge=False)
    return validate(config, type(settings))


def require_fit(chosen: PolicySetup, env: EnvBase) -> None:
    """Refuse, before the first step, a run's policy whose inputs or actions do not fit an environment."""
    import torch

    if chosen.run is None:
        return
    try:
        with torch.no_grad(), torch.random.fork_rng(devices=[]):
            written = tuple(chosen.policy(env.fake_tensordict())["action"].shape)
        wanted = tuple(env.full_action_spec["action"].shape)
        reason = None if written == wanted else f"it writes actions of shape {written}, not {wanted}"
    except (RuntimeError, KeyError) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
    if reason is not None:
        raise UavrlError(
            f"The policy and env={chosen.choices.get('env')} do not go together ({reason}): leave env out, or choose "
            f"another policy."
        )
