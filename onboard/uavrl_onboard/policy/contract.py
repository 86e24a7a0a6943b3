"""``contract.json``: what another program must know to give a policy its inputs and to fly its actions.

One model does all three: `uavrl.export.export` makes it with :meth:`Contract.of` and writes it, :func:`read_contract`
validates it, and :meth:`Contract.contradiction` compares it with what this version of uavrl would have made. Its parts
are in :mod:`uavrl_onboard.policy.contract_parts`, its sentences in :mod:`uavrl_onboard.policy.explanations`.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import Field, ValidationError

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.perception.motion import OBJECT, threats
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.perception.observation import Angles
from uavrl_onboard.perception.view import VLP16_VIEW, View, with_rows
from uavrl_onboard.policy import explanations as says
from uavrl_onboard.policy.contract_parts import (
    ACTION,
    ANGLES,
    Action,
    Cells,
    Cloud,
    ContractPart,
    Entry,
    GuardTerms,
    MotionTerms,
    Network,
    Quantity,
    Scale,
    StateTerms,
    alike,
)
from uavrl_onboard.vehicle import Vehicle

CONTRACT, NETWORK = "contract.json", "policy.onnx"  # the files of an exported policy
FORMAT, VERSION = "uavrl.contract", 1
LARGEST = 2**20  # bytes of the file; ours have ten thousand
REMEDY = "export the policy again with uavrl-export"
EXPORT = "write one by uavrl-export policy=best output=FOLDER, or with run=RUN_FOLDER, and give that folder"


class Contract(ContractPart):
    """What a program needs to give a policy its inputs and to obey its actions."""

    format: str
    version: int
    weights_sha256: str
    rate_hz: Annotated[float, Field(gt=0, le=1000)]
    moment: str = says.MOMENT
    cloud: Cloud
    cells: Cells
    pose: dict[str, str] = says.POSE
    observation: Annotated[list[Entry], Field(min_length=4, max_length=7)]
    scaling: str = says.SCALING
    state: StateTerms
    action: Action
    motion: MotionTerms | None = None  #: None for a policy that does not detect moving objects
    guards: GuardTerms | None = None  #: None for a policy that flies without guards by default
    versions: dict[str, str | None] = Field(default_factory=dict)
    network: Network | None = None  #: None where no policy.onnx was exported
    sha256: str | None = None  #: of the rest, as :meth:`sealed` sets it; None in a contract that may be edited

    @classmethod
    def of(
        cls,
        cloud: Cloud,
        cells: Cells,
        *,
        weights_sha256: str,
        rate_hz: float,
        flight_level: float,
        angles: Angles,
        frames: int,
        action_limit: float,
        last_action: bool = False,
        motion: MotionTerms | None = None,
        guards: GuardTerms | None = None,
        versions: dict[str, str | None] | None = None,
    ) -> Contract:
        """Return the contract of a policy.

        Args:
            cloud: which points count.
            cells: what the reduction makes of them.
            weights_sha256: the checksum of the file of the policy's weights.
            rate_hz: how many actions a second.
            flight_level: the altitude that is 0 in an observation, m.
            angles: how the angles to the goal are scaled.
            frames: observations in a state.
            action_limit: the greatest velocity in m/s; the yaw rate is cut at 2 rad/s.
            last_action: whether an observation holds the previous action.
            motion: how moving objects are detected.
            guards: those that it flies with by default.
            versions: of the libraries that made the policy's files.

        Examples:
            >>> cells = Cells.of("truncated_icosahedron", 4.0, "face")
            >>> terms = Contract.of(Cloud.of(4.0, (0.0, 0.0, 0.1)), cells, weights_sha256="", rate_hz=10.0,
            ...     flight_level=3.5, angles="folded", frames=3, action_limit=2.0)
            >>> terms.state.size, terms.contradiction()
            (105, None)
        """
        observation = _entries(cells, flight_level, angles, motion, action_limit if last_action else None)
        size = frames * sum(entry.size for entry in observation)
        more = says.MOTION_POSE if motion is not None else {}
        if cloud.lidar is not None:
            seen = {"cells_see": _view(cells, cloud.lidar.field_of_view)}
            cloud = cloud.model_copy(update={"lidar": cloud.lidar.model_copy(update=seen)})
        turn = min(action_limit, Vehicle().yaw_rate_limit)
        low, high = ((*(sign * action_limit,) * 3, sign * turn) for sign in (-1.0, 1.0))
        return cls(
            format=FORMAT,
            version=VERSION,
            weights_sha256=weights_sha256,
            rate_hz=rate_hz,
            cloud=cloud,
            cells=cells,
            pose=says.POSE | more,
            observation=observation,
            scaling=says.SCALING + (says.DIVISORS if motion is not None else ""),
            state=StateTerms(frames=frames, padding=0, size=size, dtype="float32"),
            action=Action(order=tuple(ACTION), low=low, high=high),  # type: ignore[arg-type]  # there are four
            motion=motion,
            guards=guards,
            versions=versions or {},
        )

    @property
    def flight_level(self) -> float:
        """The altitude that is 0 in an observation, m."""
        return self.observation[1].number

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle that the policy was trained to fly; its hull is that of the guards, if there are any."""
        velocity_limit, _, _, yaw_rate_limit = self.action.high
        lidar = self.cloud.lidar
        about: dict[str, Any] = {}
        if lidar is not None:
            about = {"lidar_elevations": lidar.field_of_view[2:], "lidar_repeats": lidar.repeats}
        about |= {} if self.guards is None else {"radius": self.guards.radius, "height": self.guards.height}
        return Vehicle(
            **about,
            lidar_position=self.cloud.sensor_position,
            velocity_limit=velocity_limit,
            yaw_rate_limit=yaw_rate_limit,
            control_rate=self.rate_hz,
            flight_level=self.flight_level,
        )

    @property
    def view(self) -> View:
        """The field of view that the cells read, which is that of the training's sensor and all rows of the cells."""
        lidar = self.cloud.lidar
        if lidar is not None and lidar.cells_see is not None:
            return lidar.cells_see
        return _view(self.cells, VLP16_VIEW if lidar is None else lidar.field_of_view)

    @property
    def guard_settings(self) -> GuardSettings:
        """The guards that the policy flies with by default."""
        return GuardSettings() if self.guards is None else self.guards.settings

    @property
    def angles(self) -> Angles:
        """How the goal angles are scaled."""
        scale = self.observation[2].scale
        return next((name for name in get_args(Angles) if ANGLES[name] == scale), "folded")

    @property
    def action_limit(self) -> float | None:
        """What the last action is divided by in an observation; None where it is not in it."""
        return next((entry.number for entry in self.observation if entry.name == "last_action"), None)

    def contradiction(self) -> str | None:
        """Return what does not hold together, or is not as this version of uavrl does it; None for a sound contract."""
        cells, cloud, state, action = self.cells, self.cloud, self.state, self.action
        made = Cells.of(cells.reduction, cells.radius, cells.statistic, cells.grid)
        ball = Cloud.of(cells.radius, cloud.sensor_position, cloud.blind)
        entries = _entries(cells, self.flight_level, self.angles, self.motion, self.action_limit)
        seen = None if cloud.lidar is None else cloud.lidar.cells_see
        wrong: dict[str, bool] = {
            "cloud.lidar.cells_see is not field_of_view with the rows of the cells": seen is not None
            and seen != _view(cells, cloud.lidar.field_of_view),  # type: ignore[union-attr]  # seen is of it
            f"cells are not those of {cells.reduction}": not alike(cells, made, "directions", atol=1e-6)
            or not alike(cells, made, "count", "columns", "rows", "width", "elevation", "row_borders"),
            f"cloud.squared_range, cells.interval or cells.offsets is not that of a radius of {cells.radius:g} m": (
                not alike(cloud, ball, "squared_range", rtol=1e-9)
                or not alike(cells, made, "interval", rtol=1e-9)
                or not alike(cells, made, "offsets")
            ),
            "observation has other quantities or scales": entries != self.observation,
            "state.size is not state.frames times the sizes in observation": state.size
            != state.frames * sum(entry.size for entry in self.observation),
            f"action.order is not {', '.join(ACTION)}": action.order != tuple(ACTION),
            "action.low is not below action.high": not np.less(action.low, action.high).all(),
        }
        repeats = cloud.lidar is None or cloud.lidar.repeats
        moving = None if self.motion is None else self.motion.contradiction(self.rate_hz, repeats)
        guarded = None if self.guards is None else self.guards.contradiction()
        return next((words for words, holds in wrong.items() if holds), moving or guarded)

    def sealed(self) -> Contract:
        """Return the contract with its checksum, so that a change of its file is noticed."""
        plain = self.model_dump(mode="json")
        return self.model_copy(update={"sha256": _checksum(plain)})

    def to_text(self) -> str:
        """Return the contract as JSON. A list or mapping of plain values takes one line."""
        text = json.dumps(self.model_dump(mode="json"), indent=1, ensure_ascii=False)
        innermost = r"([\[{])\s+([^][{}]*?)\s+([\]}])"
        return re.sub(innermost, lambda match: match[1] + " ".join(match[2].split()) + match[3], text) + "\n"


def _checksum(plain: dict[str, Any]) -> str:
    """Return the SHA-256 of a contract's values, in any order and layout, without their checksum."""
    rest = {name: value for name, value in plain.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _view(cells: Cells, seen: View) -> View:
    """Return what cells read of what a sensor sees: all rows of a range image, too."""
    return with_rows(seen, cells.grid.elevation) if cells.reduction == "range_image" else seen


def _entries(
    cells: Cells,
    flight_level: float,
    angles: Angles,
    motion: MotionTerms | None,
    last_action: float | None,
) -> list[Entry]:
    """Return the observation that :mod:`uavrl_onboard.perception.observation` makes of these."""
    angle = ANGLES[angles]
    scales_of: dict[Quantity, tuple[int, Scale]] = {
        "cells": (cells.count, (0.0, None, cells.radius, 0.0)),
        "altitude": (1, (0.0, None, flight_level, -1.0)),
        "heading": (1, angle),
        "elevation": (1, angle),
    }
    if motion is not None:
        each = [*map(float, scales(motion.max_range))] * motion.objects
        scales_of["moving_objects"] = (len(OBJECT) * motion.objects, (0.0, None, each, 0.0))
        scales_of["threats"] = (len(threats.DIRECTIONS) + 1, (0.0, None, threats.GREATEST, 0.0))
    if last_action is not None:
        scales_of["last_action"] = (len(ACTION), (0.0, None, last_action, 0.0))
    return [
        Entry(name=name, size=size, shift=shift, modulo=modulo, divisor=divisor, offset=offset)
        for name, (size, (shift, modulo, divisor, offset)) in scales_of.items()
    ]


def read_contract(folder: Path) -> Contract:
    """The contract in a folder.

    Raises:
        UavrlError: where there is none, or it is damaged, of another version, or contradicts itself.
    """
    path = folder / CONTRACT
    content = read_file(path, LARGEST)
    try:
        found = Contract.model_validate_json(content)
    except ValidationError as error:
        raise UavrlError(_told(path, error.errors()[0])) from error
    if (found.format, found.version) != (FORMAT, VERSION):
        raise UavrlError(f"{path} is not of {FORMAT} {VERSION}, which this version of uavrl reads: {REMEDY}.")
    if (wrong := found.contradiction()) is not None:
        raise UavrlError(f"{path} does not hold together, or is another uavrl's ({wrong}): {REMEDY}.")
    if found.sha256 is not None and found.sha256 != _checksum(json.loads(content)):
        keys = "hull, guards and limits are keys of uavrl-fly (hull.…, guards=, safety.…)"
        raise UavrlError(f"{path} was changed after its export, as its checksum differs: {REMEDY}; {keys}.")
    return found


def read_file(path: Path, largest: int) -> bytes:
    """What is in a file of an exported policy."""
    if not path.is_file():
        raise UavrlError(f"Expected an exported policy with {path} and found no such file: {EXPORT}.")
    if path.stat().st_size > largest:
        raise UavrlError(f"{path} has more than {largest:,} bytes, which no policy needs: {REMEDY}.")
    return path.read_bytes()


def _told(path: Path, first: Any) -> str:
    """What pydantic found first, in a sentence."""
    # Of a value that may be of two types, pydantic also tells which one it tried.
    where = ".".join(str(part) for part in first["loc"] if isinstance(part, int) or part.isidentifier()) or "its text"
    return f"{path} is damaged ({where}: {first['msg']}): {REMEDY}."
