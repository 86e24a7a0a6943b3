"""A policy to be given away: its weights and configuration, its network as ONNX, and ``contract.json``.

The contract is all that another program must know to give a policy its inputs and to obey its actions. Nothing in it is
written for one policy: it is read off the transforms that a run's configuration makes.
"""

import hashlib
import json
import logging
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import CatFrames, EnvBase, Transform

from uavrl.config import TrainConfig, validate
from uavrl.config.build import TARGET, build, find_class
from uavrl.envs import Airframe, NavigationEnv
from uavrl.envs.simulation import CONTROL_RATE
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import POLICY_INFO, load_actor
from uavrl.evaluation.environment import inner_transforms
from uavrl.export import memory_terms as memory
from uavrl.export import motion_terms as motion
from uavrl.export.onnx_export import INPUT, OPSET, OUTPUT, policy_onnx
from uavrl.runs.names import CONFIG
from uavrl.runs.provenance import versions
from uavrl.runs.weights import POLICY
from uavrl.transforms import (
    LastAction,
    MovingObjects,
    NavigationObservation,
    NavigationState,
    PointCloudReduction,
    RangeImage,
    Threats,
    Waypoint,
)
from uavrl.transforms.icosahedron import truncated_icosahedron_faces
from uavrl.transforms.state import ACTION_LIMIT, REDUCTIONS
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.perception.cells import TOUCHING, VLP16_GRID, return_bounds
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.perception.motion.threats import DIRECTIONS, GREATEST
from uavrl_onboard.policy.contract import ACTION, ANGLES, CONTRACT, FORMAT, NETWORK, VERSION, Divisor

log = logging.getLogger(__name__)

CELL_OF = {
    "truncated_icosahedron": "a point p with directions[i] · p > offsets[i] for any cell i belongs to none; any other "
    "belongs to the cell whose centre, offsets[i] * directions[i], is nearest to it",
    "range_image": "in degrees: column = round(atan2(y, x) / width) mod columns; "
    "row = how many of row_borders are less than atan2(z, hypot(x, y)); cell = rows * column + row",
}
LENGTH_OF = {
    "face": "the distance from the point to its cell's centre, offsets[i] * directions[i]",
    "range": "the distance from the sensor to the point",
    "proximity": "the distance from the sensor to the point",
}
SCALING = "((value + shift) mod modulo) / divisor + offset; no modulo where it is null"
POSE = {
    "axes": "world: z up; x, y, z are those of the middle of the airframe, yaw is its head's, counter-clockwise from x",
    "altitude": "m: z, above the mean level of the ground",
    "heading": "degrees in [0, 360): atan2(goal_y - y, goal_x - x) - yaw; 0 is ahead, 90 is left",
    "elevation": "degrees in [0, 360): atan2(goal_z - z, hypot(goal_x - x, goal_y - y)); 0 is level, 90 is above",
    "goal": "the middle of the goal's cylinder, half-way from the ground to the ceiling",
    "last_action": "the action before, as the policy gave it; zeros at the first step",
}


def export_policy(
    folder: Path, checkpoint: str | None, output: Path, packages: Iterable[str] = (), *, network: bool = True
) -> dict[str, Any]:
    """Writes ``config.yaml``, the weights with ``policy.json``, and ``contract.json`` where there is one.

    With the contract goes ``policy.onnx`` if ``network``; where it cannot be made, a warning says why. The policy is
    that of :func:`load_actor`; what ``policy.json`` says of it is returned.
    """
    config, actor, known = load_actor(folder, checkpoint, "cpu", packages)
    about = {key: known[key] for key in ("run", *POLICY_INFO, "versions") if key in known}
    if POLICY.is_in(output) or (output / CONFIG).exists():
        raise UavrlError(f"The folder {output} holds a policy or a run already: choose another with output=FOLDER.")
    writable(output / POLICY.json, "output=FOLDER")
    config.run_dir = Path(str(config.run_dir)).name
    with replacing(output / CONFIG) as partial:
        partial.write_text(OmegaConf.to_yaml(config), encoding="utf-8")
    saved = POLICY.save(output, actor.state_dict(), {"run": folder.resolve().name, **about})
    terms = contract(validate(config), saved["weights_sha256"])
    if terms is not None:
        terms |= _write_network(output, actor, terms) if network else {}
        with replacing(output / CONTRACT) as partial:
            partial.write_text(as_text(terms), encoding="utf-8")
    return saved


def _write_network(output: Path, actor: TensorDictModuleBase, terms: dict[str, Any]) -> dict[str, Any]:
    """Writes ``policy.onnx``, and returns what the contract says about it."""
    try:
        content = policy_onnx(actor, terms)
    except UavrlError as error:
        log.warning("%s", error)
        return {}
    with replacing(output / NETWORK) as partial:
        partial.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    return {"network": {"file": NETWORK, "sha256": digest, "opset": OPSET, "input": INPUT, "output": OUTPUT}}


def contract(settings: TrainConfig, weights_sha256: str) -> dict[str, Any] | None:
    """The contract of a policy that was trained with these settings; None where the valley's definitions do not hold.

    They hold for a :class:`~uavrl.transforms.NavigationState` in a :class:`~uavrl.envs.NavigationEnv`; what somebody
    else's perception or environment means, nobody here can say.

    Args:
        settings: the validated configuration of the run.
        weights_sha256: the checksum of the file of the policy's weights.
    """
    env = find_class(str(settings.env[TARGET]), EnvBase, settings.packages)
    sensor = getattr(settings.env.get("airframe"), "lidar_position", Airframe().lidar_position)
    state = build(settings.perception, Transform, packages=settings.packages, sensor_position=sensor)
    if type(state) is not NavigationState or not issubclass(env, NavigationEnv):
        return None
    parts: dict[type, Any] = {type(part): part for part in inner_transforms(state)}
    seen, led = parts.get(MovingObjects), parts.get(Waypoint)
    reduction = next(part for part in parts.values() if isinstance(part, PointCloudReduction))
    frames = next(part for part in parts.values() if isinstance(part, CatFrames))
    scaled = parts[NavigationObservation]
    observation = [
        _entry("cells", len(reduction.directions()), divisor=scaled.radius),
        _entry("altitude", 1, divisor=scaled.flight_level, offset=-1.0),
        *(
            _entry(angle, 1, *ANGLES[scaled.angles])
            for angle in ("heading" if led is None else "waypoint", "elevation")
        ),
        *(_motion_entries(seen) if seen is not None else []),
        *([_entry("last_action", len(ACTION), divisor=ACTION_LIMIT)] if LastAction in parts else []),
    ]
    return {
        "format": FORMAT,
        "version": VERSION,
        "weights_sha256": weights_sha256,
        "rate_hz": CONTROL_RATE,
        "moment": "cloud and pose are of one moment, and the action answers them at once",
        "cloud": _cloud(reduction.radius, settings),
        "cells": _cells(reduction),
        "pose": POSE | ({} if seen is None else motion.POSE) | ({} if led is None else memory.POSE),
        "observation": observation,
        "scaling": SCALING if seen is None else f"{SCALING}; a list has a divisor for each number",
        "state": {
            "frames": frames.N,
            "order": "oldest observation first",
            "padding": frames.padding_value,
            "size": frames.N * sum(entry["size"] for entry in observation),
            "dtype": "float32",
        },
        "action": _action(ACTION_LIMIT),
        **({} if seen is None else {"motion": motion.motion_terms(seen, parts[Threats])}),
        **({} if led is None else {"memory": memory.memory_terms(led)}),
        "versions": versions(),
    }


def _entry(
    name: str, size: int, shift: float = 0.0, modulo: float | None = None, divisor: Divisor = 1.0, offset: float = 0.0
) -> dict[str, Any]:
    """One of the quantities in an observation, and how it is scaled."""
    return {"name": name, "size": size, "shift": shift, "modulo": modulo, "divisor": divisor, "offset": offset}


def _motion_entries(seen: MovingObjects) -> list[dict[str, Any]]:
    """Those of what moves."""
    each = list(scales(seen.max_range) * seen.objects)
    ways = len(DIRECTIONS) + 1
    return [_entry("moving_objects", len(each), divisor=each), _entry("threats", ways, divisor=GREATEST)]


def _action(limit: float) -> dict[str, Any]:
    """What the policy's numbers mean."""
    return {
        "order": list(ACTION),
        "unit": list(ACTION.values()),
        "low": [-limit] * len(ACTION),
        "high": [limit] * len(ACTION),
        "clip": "to low and high, before it is flown",
        "frame": "yaw-aligned body frame: the world's, turned about the vertical by the yaw alone, level at any tilt",
        "holds": "until the next one",
    }


def _cloud(radius: float, settings: TrainConfig) -> dict[str, Any]:
    """What a scan is, and which of its points count."""
    return {
        "shape": ["points", 3],
        "unit": "m",
        "frame": "sensor: x forward, y left, z up, fixed to the vehicle and tilted with it",
        "sensor": "one turn of a Velodyne VLP-16, its points in any order",
        "position": "of the sensor in body axes, from the middle of the airframe",
        "sensor_position": list((settings.env.get("airframe") or Airframe()).lidar_position),
        "miss": "a coordinate that is not finite, or x² + y² + z² not between these two, themselves excluded",
        "squared_range": list(return_bounds(radius)),
        "blind": bool(settings.perception.get("blind")),  # trained with misses alone: give it no other
    }


def _cells(reduction: PointCloudReduction) -> dict[str, Any]:
    """What the cells of a reduction are and report, in their order."""
    name = next(name for name, kind in REDUCTIONS.items() if type(reduction) is kind)
    directions, radius, statistic = reduction.directions(), reduction.radius, reduction.statistic
    offsets: list[float] = [radius] * len(directions)
    grid: dict[str, Any] = {}
    if isinstance(reduction, RangeImage):
        cells = reduction.grid
        grid = {"columns": cells.columns, "rows": cells.rows, "width": 360 / cells.columns}
        grid |= {} if cells.elevation == VLP16_GRID.elevation else {"elevation": list(cells.elevation)}
        grid |= {"row_borders": [round(border, 9) for border in cells.row_borders]}
    else:
        offsets = [round(offset, 9) for offset in truncated_icosahedron_faces(radius).offsets.double().tolist()]
    least = "the least over the cell's points, cut to the interval; "
    return {
        "reduction": name,
        "count": len(directions),
        "radius": radius,
        "directions": [[round(x, 9) + 0.0 for x in row] for row in directions.double().tolist()],
        "offsets": offsets,
        **grid,
        "cell": CELL_OF[name],
        "statistic": statistic,
        "length": LENGTH_OF[statistic],
        "interval": [TOUCHING * radius, radius],
        "value": least + ("radius - that, 0" if statistic == "proximity" else "0") + " where the cell has no point",
    }


def as_text(content: dict[str, Any]) -> str:
    """A contract as json, what holds no more lists or mappings in a line of its own."""
    text = json.dumps(content, indent=1, ensure_ascii=False)
    innermost = r"([\[{])\s+([^][{}]*?)\s+([\]}])"
    return re.sub(innermost, lambda match: match[1] + " ".join(match[2].split()) + match[3], text) + "\n"
