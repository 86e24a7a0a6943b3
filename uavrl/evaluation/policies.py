"""What evaluation and replay share: which policy acts in which environment, and what its results are called."""

from __future__ import annotations

import hashlib
import inspect
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.config import TrainConfig, validate
from uavrl.config.build import TARGET, build, find_class
from uavrl.config.context import CONTEXT
from uavrl.config.parts import Part
from uavrl.config.settings import EvaluateConfig, FlyingConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.overrides import keys_of, require_sensor_alone, require_valley, with_overrides
from uavrl.evaluation.worlds import TRAINING, UNSEEN, unseen_seeds, without_variety
from uavrl.runs.config import require_typed_run
from uavrl.runs.labels import label
from uavrl.runs.names import LONGEST_NAME
from uavrl.runs.weights import POLICY
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.policy.contract import CONTRACT, read_contract
from uavrl_onboard.sentences import did_you_mean

if TYPE_CHECKING:
    import torch
    from torchrl.envs import EnvBase

    from uavrl.evaluation.loaded import LoadedPolicy
    from uavrl.policy_protocol import TensorDictPolicy

PACKAGED = Path(__file__).parents[1] / "policies" / "data"  # what `policy=NAME` names, beside the baselines
SENSOR = "perception.lidar.sensor"
EXPORTED = "uavrl.export.simulated.ExportedPolicy"  # what flies a folder; its room knows this one
BASELINES = {
    "straight": "uavrl.policies.baselines.StraightPolicy",
    "vfh": "uavrl.policies.baselines.VectorFieldHistogram",
    "vfh_privileged": "uavrl.policies.privileged.PrivilegedVFH",
    "vfh_star": "uavrl.planners.vfh_star.VFHStar",
    "mppi": "uavrl.planners.mppi.MPPI",
    "potential_field": "uavrl.planners.potential_field.PotentialField",
    "rrt_connect": "uavrl.planners.rrt_connect.RRTConnect",
    "rrt_map": "uavrl.planners.rrt_map.RRTMap",
}
"""The classes of the policies that learn nothing, by the name that chooses them on the command line."""

# Keys of an evaluation that do not say which policy was evaluated in which tasks.
PLAIN_KEYS = ("run", "packages", "episodes", "output", "device", "threads", "matmul", "progress")


@dataclass(frozen=True)
class PolicySetup:
    """A policy and its environment."""

    policy: TensorDictPolicy
    env: Part
    perception: Part
    reward: Part
    choices: Mapping[str, str]  # the yaml file of each part
    source: dict[str, Any]  # what a result says about the policy
    run: TrainConfig | None = None  # where it comes from, with what the command line changed; None for a baseline
    guards: GuardSettings = field(default_factory=GuardSettings)  # between the policy and the environment

    @property
    def env_options(self) -> dict[str, Any]:
        """Options of :func:`~uavrl.evaluation.environment.make_env`: guards, and what makes it emit the ``in_keys``."""
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
    """Loads what the command line asks for."""
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
        chosen.source["label"] = f"{label(run.choices)}, seed {run.seed}"
        trained, flown = policy.config.env.get("world"), changed.env.get("world")
        if trained is not None and flown is not None and trained.get(TARGET) == flown.get(TARGET):
            chosen.source["training_valleys"] = list(trained.seeds)
    chosen = _in_view(chosen, settings, policy)
    _choose_valleys(chosen, settings, keys_of(overrides))
    return _guarded(chosen, settings, keys_of(overrides), default_guards(folder, policy))


def _choose_valleys(chosen: PolicySetup, settings: FlyingConfig, given: Collection[str]) -> None:
    """Puts the valleys that the command line asks for into the environment, or else those that no training used."""
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
    """The same policy, whose LiDAR has been found to see its cells; its source says which LiDAR is another one."""
    from uavrl.evaluation.field_of_view import TRAINED_WITH, check_field_of_view, trained_sensor

    if (lidar := chosen.perception.get("lidar")) is None:
        return chosen
    trained_with = None
    if chosen.run is not None:
        trained_with = trained_sensor(policy.config)  # type: ignore[attr-defined]  # of a run it is a LoadedPolicy
    elif policy.overrides is not None:
        trained_with = policy.overrides.get(SENSOR, TRAINED_WITH)
    allowed = settings.allow_unseen
    unseen = check_field_of_view(chosen.perception, trained_with, settings.packages, allowed=allowed)
    if lidar.device.name == TRAINED_WITH:
        return chosen
    return replace(chosen, source={**chosen.source, "lidar": lidar.device.name, "unseen_cells": unseen})


def default_guards(folder: Path | None, policy: TensorDictPolicy | None = None) -> GuardSettings:
    """Return the guards that a policy flies with by default: those of its contract, or none without a contract."""
    if folder is not None and (folder / CONTRACT).is_file():
        return read_contract(folder).guard_settings
    return GuardSettings() if policy is None else policy.guards


def _guarded(
    chosen: PolicySetup, settings: FlyingConfig, given: Collection[str], default: GuardSettings
) -> PolicySetup:
    """The same policy behind the guards that the command line asks for, or else its own."""
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
    """The settings with the perception and the sensor of an exported policy; as they are for any other."""
    if policy.overrides is None:
        return settings
    config = config.copy()
    given = keys_of(overrides)
    require_sensor_alone(given, ("perception",), "policy")
    for key, value in policy.overrides.items():
        if key not in given and OmegaConf.select(config, key.rpartition(".")[0]) is not None:
            OmegaConf.update(config, key, value, merge=False)
    return validate(config, type(settings))


def require_fit(chosen: PolicySetup, env: EnvBase) -> None:
    """Refuses a run's policy that reads or writes other numbers than an environment has, before the first step."""
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


def result_overrides(overrides: Sequence[str], plain: Collection[str] = PLAIN_KEYS) -> list[str]:
    """The overrides of a command line whose keys are not plain: those by which its result differs from another one."""
    return [override for override in overrides if override.split("=")[0] not in plain]


def output_name(stem: str, overrides: Sequence[str]) -> str:
    """A file name without suffix in which the overrides stand."""
    told = [re.sub(r"[^\w.=-]+", "-", override).replace("=-", "=").strip("-") for override in overrides]
    name = "_".join([stem, *told])
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def packaged_policies() -> list[str]:
    """The names of the policies that come with the package."""
    return sorted(path.parent.name for path in PACKAGED.glob(f"*/{POLICY.json}"))


def policy_folder(run: str | None, policy: str | None) -> Path | None:
    """Where the policy lies that the command line names: a run, or a packaged policy; None for a baseline."""
    require_one(run, policy)
    if run is not None:
        return Path(run)
    return PACKAGED / str(policy) if policy in packaged_policies() else None


def require_one(run: object, policy: object) -> None:
    """Refuses a command line with both a run and a policy, or with neither; loads no torch."""
    if (run is None) == (policy is None):
        raise UavrlError("Give either run=RUN_FOLDER or policy=NAME, and not both.")


def require_policy(name: object) -> None:
    """Refuses a name that means no policy; loads no torch."""
    names = [*BASELINES, *packaged_policies()]
    if isinstance(name, str) and name not in names and "." not in name and exported_folder(name) is None:
        hint = (
            "for your own give run=RUN_FOLDER, an exported folder, a .zip of Stable-Baselines3 or PACKAGE.MODULE.CLASS."
        )
        raise unknown_policy(name, names, hint)


def require_named(config: DictConfig) -> None:
    """Refuses a command line whose policy or run is not there; a value that cannot be read is told with all others."""
    with suppress(OmegaConfBaseException):
        require_policy(config.policy)
        if config.policy is None:
            require_typed_run(config)


def load_policy(
    policy: str | Path,
    *,
    checkpoint: str | Path | None = None,
    device: str = "cpu",
    packages: Iterable[str] = (),
    guards: Any = None,
) -> LoadedPolicy:
    """Loads a trained policy: it reads what an environment emits, and writes ``action``.

    Environments for it come from :meth:`~uavrl.evaluation.loaded.LoadedPolicy.make_env`.

    Args:
        policy: the name of a packaged policy (``"best"``), the folder of a run, or one that ``uavrl-export`` wrote.
        checkpoint: the file of one of a run's checkpoints; None: the newest.
        device: where the network is computed: ``cpu``, ``cuda``, ``cuda:<index>`` or ``auto``.
        packages: whose code may be executed because the run names their classes.
        guards: those of the environments that its ``make_env`` makes: ``"all"``, ``"none"``, a list of names, or as
            :func:`~uavrl_onboard.guards.settings.guard_settings` reads it. None: as its contract says.

    Raises:
        UavrlError: where there is no such policy, or its files are damaged, and for an unknown guard.

    Examples:
        >>> policy = load_policy("best")
        >>> env = policy.make_env(num_uavs=2)
        >>> env.rollout(5, policy)["action"].shape  # 2 vehicles, 5 steps, 3 velocities and a yaw rate
        torch.Size([2, 5, 4])
    """
    name, folder = str(policy), Path(policy).expanduser()
    if name in packaged_policies():
        folder = PACKAGED / name
    elif not folder.is_dir() and "/" not in name:
        own = "for your own give the folder of a run, or one that uavrl-export wrote."
        raise unknown_policy(name, packaged_policies(), own)
    from uavrl.evaluation import actor, environment

    at, chosen = environment.make_device(device), guard_settings(guards, default_guards(folder))
    loaded = actor.read_policy(folder, None if checkpoint is None else str(checkpoint), at, tuple(packages))
    loaded.guards = chosen
    return loaded


def named_policy(
    name: str, told: Mapping[str, Any], packages: Sequence[str], vecnormalize: str | None = None
) -> TensorDictPolicy:
    """A policy that is no run: a baseline, a ``.zip`` of Stable-Baselines3, or a ``PACKAGE.MODULE.CLASS``.

    Of ``told``, ``flight_level``, ``airframe`` and what perception says (``radius``, …), a baseline is given what its
    constructor names, any other class the ``flight_level``. Opening a ``.zip`` can run programs: ``packages`` must name
    ``stable_baselines3``; ``vecnormalize`` is the file of its statistics. A folder is one that ``uavrl-export`` wrote.
    """
    from uavrl.policy_protocol import as_policy

    require_policy(name)
    target = BASELINES.get(name, name)
    if name.endswith(".zip"):
        from uavrl.evaluation.sb3 import StableBaselinesPolicy

        if "stable_baselines3" not in packages:
            trust = "if you trust whoever made it, add packages=[stable_baselines3] to the command"
            raise UavrlError(f"Opening {name} runs whatever program it holds: {trust}.")
        return as_policy(StableBaselinesPolicy(name, vecnormalize))
    own: dict[str, Any] = {}
    if name not in BASELINES and (folder := exported_folder(name)) is not None:
        target, own = EXPORTED, {"folder": folder}
    context = {key: told[key] for key in CONTEXT["policy"]}
    seen = {key: value for key, value in told.items() if key not in context} if name in BASELINES else own
    made = build({**seen, TARGET: target}, object, packages=packages, **context)
    if not callable(made):
        raise UavrlError(f"policy must read a tensordict and write its action, but {name} makes {made!r}.")
    return as_policy(made)


def unknown_policy(name: str, names: Sequence[str], own: str) -> UavrlError:
    """Says which names a policy may have, and how to name one of one's own."""
    near = did_you_mean(name, names, ": ", own)
    return UavrlError(f"policy must be one of {', '.join(names)}, got {name!r}{near}")


def exported_folder(name: str) -> Path | None:
    """The folder of an exported policy that a name means; None for a name of another kind."""
    path = Path(name).expanduser() if name.startswith("~/") else Path(name)
    return path if "/" in name or path.is_dir() else None


def file_of_policy(name: str, packages: Sequence[str]) -> Path | None:
    """The file that a policy of :func:`named_policy` comes from; None for a baseline, and where there is none."""
    path = Path(name)
    if path.suffix != ".zip":
        if (folder := exported_folder(name)) is not None:
            return folder / CONTRACT if (folder / CONTRACT).is_file() else None
        if "." not in name:
            return None
        path = Path(inspect.getsourcefile(find_class(name, object, packages)) or "")
    return path if path.is_file() else None
