"""A policy to be given away: its weights and configuration, its network as ONNX, and ``contract.json``.

Nothing in the contract is written for one policy: its numbers are those of the transforms that the run's configuration
makes. What it holds is defined in :mod:`uavrl_onboard.policy.contract`.
"""

import hashlib
import logging
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import OmegaConf
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import CatFrames, EnvBase, Transform

from uavrl.config import TrainConfig, validate
from uavrl.config.build import TARGET, build, find_class
from uavrl.envs import Airframe, LidarConfig, NavigationEnv
from uavrl.envs.simulation import CONTROL_RATE
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import POLICY_INFO, load_actor
from uavrl.export.model_card import STATEMENTS, read_statements, write_card
from uavrl.export.onnx_export import INPUT, MEMORY_INPUT, MEMORY_OUTPUT, OUTPUT, opset_of, policy_onnx
from uavrl.models.memory import RecurrentPolicy
from uavrl.runs.directions import keep_directions, with_name_alone
from uavrl.runs.names import CONFIG
from uavrl.runs.provenance import versions
from uavrl.runs.weights import POLICY, require_free
from uavrl.transforms import (
    LastAction,
    MovingObjects,
    NavigationObservation,
    NavigationState,
    PointCloudReduction,
    RangeImage,
    Threats,
)
from uavrl.transforms.composition import inner_transforms
from uavrl.transforms.state import REDUCTIONS
from uavrl_onboard.files import writable
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.policy.contract import CONTRACT, NETWORK, Contract
from uavrl_onboard.policy.contract_parts import Cells, Cloud, GuardTerms, LidarTerms, MemoryTerms, MotionTerms, Network

log = logging.getLogger(__name__)


def export_policy(
    folder: Path,
    checkpoint: str | None,
    output: Path,
    packages: Iterable[str] = (),
    *,
    network: bool = True,
    guards: GuardSettings | None = None,
) -> dict[str, Any]:
    """Writes ``config.yaml``, the weights with ``policy.json``, a model card, and ``contract.json`` where there is one.

    With the contract goes ``policy.onnx`` if ``network``; where it cannot be made, a warning says why. ``guards`` are
    those that the policy flies with by default. The policy is that of :func:`load_actor`; what ``policy.json`` says of
    it is returned. The folder holds no policy before all of it is written: without its contract it would fly without
    its guards.
    """
    require_free(output)
    config, actor, known = load_actor(folder, checkpoint, "cpu", packages)
    about = {key: known[key] for key in ("run", *POLICY_INFO, "versions") if key in known}
    read_statements(folder)
    writable(output / POLICY.json, "output=FOLDER")
    config.run_dir = Path(str(config.run_dir)).name
    keep_directions(config, output)
    with TemporaryDirectory(prefix=".export-", dir=output) as temporary:
        made = Path(temporary)
        (made / CONFIG).write_text(OmegaConf.to_yaml(with_name_alone(config)), encoding="utf-8")
        saved = POLICY.save(made, actor.state_dict(), {"run": folder.resolve().name, **about})
        terms = contract(validate(config), saved["weights_sha256"], guards)
        if terms is not None:
            terms = terms.model_copy(update={"network": _write_network(made, actor, terms) if network else None})
            (made / CONTRACT).write_text(terms.sealed().to_text(), encoding="utf-8")
        if (folder / STATEMENTS).is_file():
            (made / STATEMENTS).write_bytes((folder / STATEMENTS).read_bytes())
        for file in sorted(made.iterdir(), key=lambda each: each.name == POLICY.json):  # which makes it a policy
            file.replace(output / file.name)
    write_card(output, output.resolve().name, evaluated=folder)
    return saved


def _write_network(output: Path, actor: TensorDictModuleBase, terms: Contract) -> Network | None:
    """Write ``policy.onnx``, and return what the contract says about it."""
    try:
        content = policy_onnx(actor, terms.state.size, terms.action.low, terms.action.high)
    except UavrlError as error:
        log.warning("%s", error)
        return None
    (output / NETWORK).write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    memory = None
    if isinstance(actor, RecurrentPolicy):
        memory = MemoryTerms(input=MEMORY_INPUT, output=MEMORY_OUTPUT, size=actor.memory.size)
    return Network(file=NETWORK, sha256=digest, opset=opset_of(content), input=INPUT, output=OUTPUT, memory=memory)


def _lidar(settings: TrainConfig) -> LidarTerms:
    """Return what the contract says about the LiDAR of the training."""
    device = (settings.perception.get("lidar") or LidarConfig()).device
    return LidarTerms(name=device.name, field_of_view=device.field_of_view, repeats=device.repeats)


def contract(settings: TrainConfig, weights_sha256: str, guards: GuardSettings | None = None) -> Contract | None:
    """Return the contract of a policy that was trained with these settings; None if the definitions do not hold.

    They hold for a :class:`~uavrl.transforms.NavigationState` in a :class:`~uavrl.envs.NavigationEnv`. The quantities
    of another perception or environment may mean something else.

    Args:
        settings: the validated configuration of the run.
        weights_sha256: the checksum of the file of the policy's weights.
        guards: those that the policy flies with by default; None for none.
    """
    env = find_class(str(settings.env[TARGET]), EnvBase, settings.packages)
    airframe = settings.env.get("airframe") or Airframe()
    position = getattr(airframe, "lidar_position", Airframe().lidar_position)
    state = build(settings.perception, Transform, packages=settings.packages, sensor_position=position)
    if type(state) is not NavigationState or not issubclass(env, NavigationEnv):
        return None
    parts: dict[type, Any] = {type(part): part for part in inner_transforms(state)}
    reduction = next(part for part in parts.values() if isinstance(part, PointCloudReduction))
    name = next(name for name, kind in REDUCTIONS.items() if type(reduction) is kind)
    grid = [reduction.grid] if isinstance(reduction, RangeImage) else []
    scaled, seen = parts[NavigationObservation], parts.get(MovingObjects)
    motion, lidar = None, _lidar(settings)
    if seen is not None:
        repeats = lidar is None or lidar.repeats
        motion = MotionTerms.of(seen.max_range, seen.objects, seen.period, parts[Threats].speed, repeats)
    x, y, z = map(float, position)
    return Contract.of(
        Cloud.of(reduction.radius, (x, y, z), bool(settings.perception.get("blind")), lidar),
        Cells.of(name, reduction.radius, reduction.statistic, *grid),
        weights_sha256=weights_sha256,
        rate_hz=CONTROL_RATE,
        flight_level=scaled.flight_level,
        angles=scaled.angles,
        frames=next(part.N for part in parts.values() if isinstance(part, CatFrames)),
        action_limit=state.max_speed,
        last_action=LastAction in parts,
        motion=motion,
        guards=GuardTerms.of(guards or GuardSettings(), airframe.vehicle(scaled.flight_level, state.max_speed)),
        versions=versions(),
    )
