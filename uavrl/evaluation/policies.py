"""The policies that a command line or a program can name: packaged ones, runs, exported folders, baselines, classes."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl.config.build import TARGET, build, find_class
from uavrl.config.context import CONTEXT
from uavrl.errors import UavrlError
from uavrl.runs.config import read_config, require_typed_run
from uavrl.runs.weights import POLICY
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.policy.contract import CONTRACT, read_contract
from uavrl_onboard.sentences import did_you_mean

if TYPE_CHECKING:
    from uavrl.evaluation.loaded import LoadedPolicy
    from uavrl.policy_protocol import TensorDictPolicy

PACKAGED = Path(__file__).parents[1] / "policies" / "data"  # the folders of the packaged policies
EXPORTED = "uavrl.export.simulated.ExportedPolicy"  # A string, because its room imports this one.
BASELINES = {
    "straight": "uavrl.policies.baselines.StraightPolicy",
    "vfh": "uavrl.policies.baselines.VectorFieldHistogram",
    "vfh_mapped": "uavrl.policies.privileged.MappedVFH",
    "vfh_mapped_traps": "uavrl.policies.privileged.TrapMappedVFH",
    "vfh_privileged": "uavrl.policies.privileged.PrivilegedVFH",
    "vfh_star": "uavrl.planners.vfh_star.VFHStar",
    "mppi": "uavrl.planners.mppi.MPPI",
    "potential_field": "uavrl.planners.potential_field.PotentialField",
    "rrt_connect": "uavrl.planners.rrt_connect.RRTConnect",
    "rrt_map": "uavrl.planners.rrt_map.RRTMap",
}
"""The classes of the policies that learn nothing, by the name that chooses them on the command line."""


def packaged_policies() -> list[str]:
    """Return the names of the policies that come with the package."""
    return sorted(path.parent.name for path in PACKAGED.glob(f"*/{POLICY.json}"))


def policy_folder(run: str | None, policy: str | None) -> Path | None:
    """Return the folder of the run or of the packaged policy that a command line names; None for any other policy."""
    require_one(run, policy)
    if run is not None:
        return Path(run)
    return PACKAGED / str(policy) if policy in packaged_policies() else None


def require_one(run: object, policy: object) -> None:
    """Refuse a command line with both a run and a policy, or with neither, without importing PyTorch."""
    if (run is None) == (policy is None):
        raise UavrlError("Give either run=RUN_FOLDER or policy=NAME, and not both.")


def require_policy(name: object) -> None:
    """Refuse a name that means no policy, without importing PyTorch."""
    names = [*BASELINES, *packaged_policies()]
    if isinstance(name, str) and name not in names and "." not in name and exported_folder(name) is None:
        hint = (
            "for your own give run=RUN_FOLDER, an exported folder, a .zip of Stable-Baselines3 or PACKAGE.MODULE.CLASS."
        )
        raise unknown_policy(name, names, hint)


def require_named(config: DictConfig) -> None:
    """Refuse a policy or a run of a configuration that is not there; validation reports a value that cannot be read."""
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
    """Load a trained policy, which reads what an environment emits, and writes ``action``.

    Environments for it come from :meth:`~uavrl.evaluation.loaded.LoadedPolicy.make_env`.

    Args:
        policy: the name of a packaged policy (``"best"``), the folder of a run, or one that ``uavrl-export`` wrote.
        checkpoint: the file of one of a run's checkpoints; None: the newest.
        device: the device that computes the network: ``cpu``, ``cuda``, ``cuda:<index>`` or ``auto``.
        packages: the packages whose code may be executed, because the run names their classes.
        guards: the guards of the environments that its ``make_env`` makes: ``"all"``, ``"none"``, a list of names, or
            any other value of :func:`~uavrl_onboard.guards.settings.guard_settings`. None: those of its contract or of
            its training.

    Raises:
        UavrlError: if there is no such policy, its files are damaged, or a guard is unknown.

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


def default_guards(folder: Path | None, policy: TensorDictPolicy | None = None) -> GuardSettings:
    """Return the guards that a policy flies with by default: those of its contract, or those of its training."""
    if folder is not None and (folder / CONTRACT).is_file():
        return read_contract(folder).guard_settings
    if policy is None:
        return GuardSettings() if folder is None else guard_settings(read_config(folder).get("guards"))
    return policy.guards


def named_policy(
    name: str, told: Mapping[str, Any], packages: Sequence[str], vecnormalize: str | None = None
) -> TensorDictPolicy:
    """Return a policy that is not a run: a baseline, an exported folder, a ``.zip`` of SB3, or a class.

    Args:
        name: the name of a baseline; a folder that ``uavrl-export`` wrote; a ``.zip`` of Stable-Baselines3; or
            ``PACKAGE.MODULE.CLASS``.
        told: ``flight_level``, ``airframe`` and the keys of perception, such as ``radius``. A baseline receives those
            that its constructor names, any other class the ``flight_level``.
        packages: the packages whose code may be executed. Opening a ``.zip`` can run programs, so ``packages`` must
            contain ``stable_baselines3``.
        vecnormalize: the file with the statistics of the ``.zip``.
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
    if (folder := folder_of_policy(name)) is not None:
        target, own = EXPORTED, {"folder": folder}
    context = {key: told[key] for key in CONTEXT["policy"]}
    seen = {key: value for key, value in told.items() if key not in context} if name in BASELINES else own
    made = build({**seen, TARGET: target}, object, packages=packages, **context)
    if not callable(made):
        raise UavrlError(f"policy must read a tensordict and write its action, but {name} makes {made!r}.")
    return as_policy(made)


def unknown_policy(name: str, names: Sequence[str], own: str) -> UavrlError:
    """Return an error with the names that a policy may have, and how to name your own."""
    near = did_you_mean(name, names, ": ", own)
    return UavrlError(f"policy must be one of {', '.join(names)}, got {name!r}{near}")


def folder_of_policy(name: str) -> Path | None:
    """Return the exported folder that ``policy=NAME`` means; None for a packaged policy, a baseline, or a ``.zip``."""
    known = name in BASELINES or name in packaged_policies() or name.endswith(".zip")
    return None if known else exported_folder(name)


def exported_folder(name: str) -> Path | None:
    """Return the folder of an exported policy that a name means; None for a name of another kind."""
    path = Path(name).expanduser() if name.startswith("~/") else Path(name)
    return path if "/" in name or path.is_dir() else None


def file_of_policy(name: str, packages: Sequence[str]) -> Path | None:
    """Return the file that a policy of :func:`named_policy` comes from; None for a baseline, or without a file."""
    path = Path(name)
    if path.suffix != ".zip":
        if (folder := exported_folder(name)) is not None:
            return folder / CONTRACT if (folder / CONTRACT).is_file() else None
        if "." not in name:
            return None
        path = Path(inspect.getsourcefile(find_class(name, object, packages)) or "")
    return path if path.is_file() else None
