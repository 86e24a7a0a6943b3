"""``contract.json`` as it is read: one that is incomplete, contradicts itself or means other cells is refused.

`uavrl.export.export` writes it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN
from uavrl_onboard.guards.map import navigator
from uavrl_onboard.perception.cells import (
    LARGEST_RADIUS,
    TOUCHING,
    VLP16_GRID,
    RangeGrid,
    Statistic,
    return_bounds,
)
from uavrl_onboard.perception.motion import OBJECT, rays, threats
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.perception.observation import Angles
from uavrl_onboard.perception.reductions import Reduction, directions
from uavrl_onboard.vehicle import Vehicle

CONTRACT, NETWORK = "contract.json", "policy.onnx"  # the files of an exported policy
FORMAT, VERSION = "uavrl.contract", 1
LARGEST = 2**20  # bytes of the file; ours have ten thousand
REMEDY = "export the policy again with uavrl-export"
EXPORT = "write one by uavrl-export policy=best output=FOLDER, or with run=RUN_FOLDER, and give that folder"

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Divisor = float | list[float]
Scale = tuple[float, float | None, Divisor, float]  # shift, modulo, divisor, offset
Size = Annotated[int, Field(ge=1, le=10_000)]
Above0 = Annotated[float, Field(gt=0)]
Quantity = Literal["cells", "altitude", "heading", "waypoint", "elevation", "moving_objects", "threats", "last_action"]
# shift, modulo, divisor, offset of an angle in degrees
ANGLES: dict[str, Scale] = {
    "folded": (180.0, 360.0, 180.0, -1.0),
    "turns": (0.0, None, 360.0, 0.0),
    "raw": (0.0, None, 1.0, 0.0),
}
ACTION = {"l_x": "m/s, forward", "l_y": "m/s, left", "l_z": "m/s, up", "a_z": "rad/s, counter-clockwise from above"}


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)


class Cloud(_Part):
    """Which points of a scan count."""

    squared_range: tuple[float, float]
    sensor_position: Three  #: of the sensor in body axes, m
    blind: bool  #: whether the policy was trained with misses alone


class Cells(_Part):
    """What the reduction reports."""

    reduction: Reduction
    count: Size
    radius: Annotated[float, Field(gt=NEAREST_RETURN, le=LARGEST_RADIUS)]
    statistic: Statistic
    directions: Annotated[list[Three], Field(max_length=10_000)]
    interval: tuple[float, float]
    columns: Size | None = None  #: of a range image, as the next three
    rows: Size | None = None
    elevation: tuple[float, float] = VLP16_GRID.elevation
    row_borders: Annotated[list[float], Field(max_length=10_000)] | None = None

    @property
    def grid(self) -> RangeGrid:
        """Where the cells of a range image are."""
        if self.columns is None or self.rows is None or self.row_borders is None:
            return VLP16_GRID
        return RangeGrid(self.columns, self.rows, self.elevation, tuple(self.row_borders))

    @property
    def options(self) -> dict[str, RangeGrid]:
        """What the reduction is told beside radius and statistic."""
        return {"grid": self.grid} if self.reduction == "range_image" else {}

    @model_validator(mode="after")
    def _sound(self) -> Cells:
        """Refuses a grid that is none."""
        _ = self.grid
        return self


class Entry(_Part):
    """One of the quantities in an observation, and how it is scaled."""

    name: Quantity
    size: Size
    shift: float
    modulo: Above0 | None
    divisor: Above0 | Annotated[list[Above0], Field(max_length=10_000)]  #: a list has one for each number
    offset: float

    @property
    def scale(self) -> Scale:
        """All but what it is."""
        return self.shift, self.modulo, self.divisor, self.offset

    @property
    def number(self) -> float:
        """The divisor where it is one number; 1 otherwise."""
        return 1.0 if isinstance(self.divisor, list) else self.divisor


class State(_Part):
    """How many observations the policy reads."""

    frames: Annotated[int, Field(ge=1, le=1000)]
    padding: Literal[0]
    size: Annotated[int, Field(ge=1, le=1_000_000)]
    dtype: Literal["float32"]


class Action(_Part):
    """The limits of what the policy gives."""

    order: tuple[str, str, str, str]
    low: Four
    high: Four


class Rays(_Part):
    """Which points of a scan are searched for motion, as in :mod:`uavrl_onboard.perception.motion.rays`."""

    step: float  #: degrees from one firing cycle to the next
    first: float
    every: int


class ThreatTerms(_Part):
    """What threats are made with, as :mod:`uavrl_onboard.perception.motion.threats` has it."""

    directions: Annotated[list[Three], Field(max_length=10_000)]
    speed: Annotated[float, Field(gt=0, le=1000)]
    steps: int
    period: float
    lag: float
    wide: float
    high: float


class MotionTerms(_Part):
    """How a policy sees what moves."""

    max_range: Annotated[float, Field(gt=NEAREST_RETURN, le=1000)]
    objects: Annotated[int, Field(ge=1, le=100)]
    period: Annotated[float, Field(gt=0, le=1000)]
    rays: Rays
    threats: ThreatTerms

    def contradiction(self, rate_hz: float) -> str | None:
        """What is not as this version of uavrl does it; None for a sound part."""
        found, ways = self.threats, np.shape(threats.DIRECTIONS)
        same = np.shape(found.directions) == ways and np.allclose(found.directions, threats.DIRECTIONS, atol=1e-6)
        numbers = [found.steps, found.period, found.lag, found.wide, found.high]
        known = [threats.STEPS, threats.PERIOD, threats.LAG, threats.WIDE, threats.HIGH]
        turns = [self.rays.step, self.rays.first, self.rays.every]
        wrong: dict[str, bool] = {
            "motion.period is not that of rate_hz": not np.isclose(self.period * rate_hz, 1.0),
            "motion.rays are others": not np.allclose(turns, rays.TERMS, rtol=1e-6, atol=0),
            "motion.threats are made otherwise": not same or not np.allclose(numbers, known, rtol=1e-6, atol=0),
        }
        return next((words for words, holds in wrong.items() if holds), None)


class MemoryTerms(_Part):
    """The map whose way a policy is led along, as :mod:`uavrl_onboard.guards.map` keeps it."""

    sight: Annotated[float, Field(gt=0, le=40)]
    reach: float
    cell: float
    level: float
    every: int
    ahead: float

    def contradiction(self) -> str | None:
        """What is not as this version of uavrl does it; None for a sound part."""
        found = [self.reach, self.cell, self.level, self.every, self.ahead]
        known = [navigator.REACH, navigator.CELL, navigator.LEVEL, navigator.EVERY, navigator.AHEAD]
        return None if np.allclose(found, known, rtol=1e-6, atol=0) else "memory is another map"


class Network(_Part):
    """The file of the network."""

    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    input: str
    output: str


class Contract(_Part):
    """What a program needs to give a policy its inputs and to obey its actions."""

    format: str
    version: int
    weights_sha256: str
    rate_hz: Annotated[float, Field(gt=0, le=1000)]
    cloud: Cloud
    cells: Cells
    observation: Annotated[list[Entry], Field(min_length=4, max_length=7)]
    state: State
    action: Action
    motion: MotionTerms | None = None  #: None for a policy that is not told what moves
    memory: MemoryTerms | None = None  #: None for a policy that is not led by a map
    network: Network | None = None  #: None where no policy.onnx was exported

    @property
    def flight_level(self) -> float:
        """The altitude that is 0 in an observation, m."""
        return self.observation[1].number

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle that the policy was trained to fly; a contract does not say how large its hull is."""
        velocity_limit, _, _, yaw_rate_limit = self.action.high
        return Vehicle(
            lidar_position=self.cloud.sensor_position,
            velocity_limit=velocity_limit,
            yaw_rate_limit=yaw_rate_limit,
            control_rate=self.rate_hz,
            flight_level=self.flight_level,
        )

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
        """What does not hold together, or is not as this version of uavrl does it; None for a sound contract."""
        cells, state, action = self.cells, self.state, self.action
        towards = directions(cells.reduction, **cells.options)
        same = np.shape(cells.directions) == towards.shape and np.allclose(cells.directions, towards, atol=1e-6)
        bounds = [*return_bounds(cells.radius), TOUCHING * cells.radius, cells.radius]
        found = [*self.cloud.squared_range, *cells.interval]
        wrong: dict[str, bool] = {
            f"cells are not those of {cells.reduction}": not same or cells.count != len(towards),
            f"cloud.squared_range or cells.interval is not that of a radius of {cells.radius:g} m": not np.allclose(
                found, bounds, rtol=1e-9, atol=0
            ),
            "observation has other quantities or scales": self._entries() != self.observation,
            "state.size is not state.frames times the sizes in observation": state.size
            != state.frames * sum(entry.size for entry in self.observation),
            f"action.order is not {', '.join(ACTION)}": action.order != tuple(ACTION),
            "action.low is not below action.high": not np.less(action.low, action.high).all(),
        }
        moving = None if self.motion is None else self.motion.contradiction(self.rate_hz)
        led = None if self.memory is None else self.memory.contradiction()
        return next((words for words, holds in wrong.items() if holds), moving or led)

    def _entries(self) -> list[Entry]:
        """The observation that :mod:`uavrl_onboard.perception.observation` makes with what this one says."""
        angle = ANGLES[self.angles]
        scales_of: dict[Quantity, tuple[int, Scale]] = {
            "cells": (self.cells.count, (0.0, None, self.cells.radius, 0.0)),
            "altitude": (1, (0.0, None, self.flight_level, -1.0)),
            "heading" if self.memory is None else "waypoint": (1, angle),
            "elevation": (1, angle),
        }
        if self.motion is not None:
            each = scales(self.motion.max_range) * self.motion.objects
            scales_of["moving_objects"] = (len(OBJECT) * self.motion.objects, (0.0, None, [*each], 0.0))
            scales_of["threats"] = (len(threats.DIRECTIONS) + 1, (0.0, None, threats.GREATEST, 0.0))
        if self.action_limit is not None:
            scales_of["last_action"] = (len(ACTION), (0.0, None, self.action_limit, 0.0))
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
