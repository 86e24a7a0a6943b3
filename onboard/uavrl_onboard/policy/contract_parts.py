"""The parts of ``contract.json``, each with what this version of uavrl writes there.

:class:`uavrl_onboard.policy.contract.Contract` joins them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from uavrl_onboard.geometry import NEAREST_RETURN
from uavrl_onboard.guards.map import navigator
from uavrl_onboard.guards.settings import EvasionSettings, GuardSettings, MapSettings, ShieldSettings
from uavrl_onboard.perception.cells import (
    LARGEST_RADIUS,
    TOUCHING,
    VLP16_GRID,
    RangeGrid,
    Statistic,
    icosahedron,
    return_bounds,
)
from uavrl_onboard.perception.motion import rays, threats
from uavrl_onboard.perception.reductions import Reduction, directions
from uavrl_onboard.perception.view import is_view
from uavrl_onboard.policy import explanations as says
from uavrl_onboard.vehicle import Vehicle

VLP16 = "vlp16"
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Texts = tuple[str, str, str, str]
Divisor = float | list[float]
Scale = tuple[float, float | None, Divisor, float]  # shift, modulo, divisor, offset
Size = Annotated[int, Field(ge=1, le=10_000)]
Above0 = Annotated[float, Field(gt=0)]
Directions = Annotated[list[Three], Field(max_length=10_000)]
Quantity = Literal["cells", "altitude", "heading", "elevation", "moving_objects", "threats", "last_action"]
# shift, modulo, divisor, offset of an angle in degrees
ANGLES: dict[str, Scale] = {
    "folded": (180.0, 360.0, 180.0, -1.0),
    "turns": (0.0, None, 360.0, 0.0),
    "raw": (0.0, None, 1.0, 0.0),
}
ACTION = {"l_x": "m/s, forward", "l_y": "m/s, left", "l_z": "m/s, up", "a_z": "rad/s, counter-clockwise from above"}


class ContractPart(BaseModel):
    """A part of a contract: strict about types, and without NaN and infinity."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    @model_serializer(mode="wrap")
    def _without_absent(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out optional fields that are not there."""
        fields = type(self).model_fields
        return {name: value for name, value in dump(self).items() if value is not None or fields[name].is_required()}


class LidarTerms(ContractPart):
    """The LiDAR that a policy was trained with: what it does not see, the policy has never seen."""

    name: str
    field_of_view: Four
    unit: str = says.FIELD_OF_VIEW
    cells_see: Four | None = None  #: None in older contracts: what the sensor saw, and the rows of a range image
    outside: str = says.OUTSIDE
    repeats: bool = True  #: whether each scan has the same rays
    repeats_means: str = says.REPEATS

    @model_validator(mode="after")
    def _ascending(self) -> LidarTerms:
        """Refuse fields of view in which nothing lies."""
        if not (is_view(self.field_of_view) and is_view(self.cells_see or self.field_of_view)):
            raise ValueError("a field of view is [rightmost, leftmost, lowest, highest] in degrees, ascending")
        return self


class Cloud(ContractPart):
    """A scan, and which of its points count."""

    shape: tuple[str, int] = ("points", 3)
    unit: str = "m"
    frame: str = says.CLOUD_FRAME
    sensor: str = says.SENSOR
    position: str = says.POSITION
    sensor_position: Three  #: of the sensor in body axes, m
    miss: str = says.MISS
    squared_range: tuple[float, float]
    blind: bool  #: whether the policy was trained with misses alone
    lidar: LidarTerms | None = None  #: of the training; None for a VLP-16

    @classmethod
    def of(cls, radius: float, sensor_position: Three, blind: bool = False, lidar: LidarTerms | None = None) -> Cloud:
        """Return the part for a ball of ``radius`` metres around the sensor."""
        scan = says.SENSOR
        if lidar is not None and lidar.name != VLP16:
            scan = f"one scan of the LiDAR {lidar.name}; the points may come in any order"
        return cls(
            sensor=scan,
            sensor_position=sensor_position,
            squared_range=return_bounds(radius),
            blind=blind,
            lidar=lidar,
        )


class Cells(ContractPart):
    """What the reduction reports."""

    reduction: Reduction
    count: Size
    radius: Annotated[float, Field(gt=NEAREST_RETURN, le=LARGEST_RADIUS)]
    directions: Directions
    offsets: Annotated[list[float], Field(max_length=10_000)]  #: from the sensor to the middle of each cell, m
    columns: Size | None = None  #: None, as the next four, unless it is a range image
    rows: Size | None = None
    width: float | None = None  #: degrees
    elevation: tuple[float, float] | None = None  #: degrees; None for the field of view of a VLP-16
    row_borders: Annotated[list[float], Field(max_length=10_000)] | None = None  #: degrees
    cell: str
    statistic: Statistic
    length: str
    interval: tuple[float, float]
    value: str

    @classmethod
    def of(cls, reduction: Reduction, radius: float, statistic: Statistic, range_grid: RangeGrid = VLP16_GRID) -> Cells:
        """Return the part for a reduction; ``range_grid`` says where the cells of a range image are.

        Examples:
            >>> cells = Cells.of("range_image", 4.0, "proximity")
            >>> cells.count, cells.columns, cells.interval
            (72, 24, (4e-06, 4.0))
        """
        towards = rounded(directions(reduction, range_grid))
        grid: dict[str, Any] = {}
        offsets = [float(radius)] * len(towards)
        if reduction == "range_image":
            borders = [round(border, 9) for border in range_grid.row_borders]
            columns, elevation = range_grid.columns, range_grid.elevation
            grid = {"columns": columns, "rows": range_grid.rows, "width": 360 / columns, "row_borders": borders}
            grid |= {} if elevation == VLP16_GRID.elevation else {"elevation": elevation}
        else:
            offsets = rounded(icosahedron(radius).offsets)
        return cls(
            reduction=reduction,
            count=len(towards),
            radius=radius,
            directions=[(x, y, z) for x, y, z in towards],
            offsets=offsets,
            **grid,
            cell=says.CELL[reduction],
            statistic=statistic,
            length=says.LENGTH[statistic],
            interval=(TOUCHING * radius, radius),
            value=says.VALUE[statistic],
        )

    @property
    def grid(self) -> RangeGrid:
        """Where the cells of a range image are."""
        if self.columns is None or self.rows is None or self.row_borders is None:
            return VLP16_GRID
        elevation = VLP16_GRID.elevation if self.elevation is None else self.elevation
        return RangeGrid(self.columns, self.rows, elevation, tuple(self.row_borders))

    @property
    def options(self) -> dict[str, RangeGrid]:
        """Arguments of the reduction besides radius and statistic."""
        return {"grid": self.grid} if self.reduction == "range_image" else {}

    @model_validator(mode="after")
    def _sound(self) -> Cells:
        """Refuse a grid that is none."""
        _ = self.grid
        return self


class Entry(ContractPart):
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


class StateTerms(ContractPart):
    """How many observations the policy reads."""

    frames: Annotated[int, Field(ge=1, le=1000)]
    order: str = says.ORDER
    padding: Literal[0]
    size: Annotated[int, Field(ge=1, le=1_000_000)]
    dtype: Literal["float32"]


class Action(ContractPart):
    """The limits of what the policy gives."""

    order: Texts
    unit: Texts = tuple(ACTION.values())  # type: ignore[assignment]  # there are four
    low: Four
    high: Four
    clip: str = says.CLIP
    frame: str = says.ACTION_FRAME
    holds: str = says.HOLDS


class Rays(ContractPart):
    """Which points of a scan are searched for motion, as in :mod:`uavrl_onboard.perception.motion.rays`."""

    counts: str = says.RAYS
    step: float  #: degrees from one firing cycle to the next
    first: float
    every: Annotated[int, Field(ge=1, le=10**6)]


class ThreatTerms(ContractPart):
    """What threats are made with, as :mod:`uavrl_onboard.perception.motion.threats` has it."""

    speed: Annotated[float, Field(gt=0, le=1000)]
    steps: Annotated[int, Field(ge=1, le=10**6)]
    period: float
    lag: float
    wide: float
    high: float
    value: str = says.THREAT
    directions: Directions


class MotionTerms(ContractPart):
    """How a policy detects moving objects."""

    max_range: Annotated[float, Field(gt=NEAREST_RETURN, le=1000)]
    objects: Annotated[int, Field(ge=1, le=100)]
    object: list[str] = says.OBJECT_NUMBERS
    frame: str = says.OBJECT_FRAME
    found: str = says.OBJECTS_FOUND
    period: Annotated[float, Field(gt=0, le=1000)]
    rays: Rays
    threats: ThreatTerms

    @classmethod
    def of(cls, max_range: float, objects: int, period: float, speed: float, repeats: bool = True) -> MotionTerms:
        """Return the part for a range in m, a number of objects, a time between scans in s and a speed in m/s.

        Where the LiDAR's rays do not repeat in each scan, all returns are searched.
        """
        step, first, every = rays.TERMS
        made = ThreatTerms(
            speed=speed,
            steps=threats.STEPS,
            period=threats.PERIOD,
            lag=threats.LAG,
            wide=threats.WIDE,
            high=threats.HIGH,
            directions=[(x, y, z) for x, y, z in rounded(threats.DIRECTIONS)],
        )
        searched = Rays(step=step, first=first, every=every)
        if not repeats:
            searched = Rays(counts=says.ALL_RETURNS, step=step, first=first, every=1)
        return cls(max_range=max_range, objects=objects, period=period, rays=searched, threats=made)

    def contradiction(self, rate_hz: float, repeats: bool = True) -> str | None:
        """Return what is not as this version of uavrl does it; None for a sound part."""
        made = MotionTerms.of(self.max_range, self.objects, self.period, self.threats.speed, repeats)
        wrong: dict[str, bool] = {
            "motion.period is not that of rate_hz": not np.isclose(self.period * rate_hz, 1.0),
            "motion.rays are others": not alike(self.rays, made.rays, "step", "first", "every"),
            "motion.threats are made otherwise": not alike(self.threats, made.threats, "directions", atol=1e-6)
            or not alike(self.threats, made.threats, "steps", "period", "lag", "wide", "high"),
        }
        return next((words for words, holds in wrong.items() if holds), None)


class MapTerms(ContractPart):
    """The map that turns the heading, as :mod:`uavrl_onboard.guards.map` keeps it."""

    sight: Annotated[float, Field(gt=0, le=40)]
    reach: float = navigator.REACH
    cell: float = navigator.CELL
    level: float = navigator.LEVEL
    every: Annotated[int, Field(ge=1, le=10**6)] = navigator.EVERY
    ahead: float = navigator.AHEAD
    does: str = says.GUARD_MAP


class EvasionTerms(ContractPart):
    """The evasion of moving objects."""

    sight: Annotated[float, Field(gt=0, le=100)]
    objects: Annotated[int, Field(ge=1, le=100)]
    does: str = says.GUARD_EVASION


class ShieldTerms(ContractPart):
    """The shield, which limits the speed near obstacles."""

    time: Above0
    lag: Annotated[float, Field(ge=0)]
    margin: Annotated[float, Field(ge=0)]
    nearest: Annotated[float, Field(ge=0)] | None = None  #: shortest range that the sensor reports, m
    does: str = says.GUARD_SHIELD


class GuardTerms(ContractPart):
    """The guards that a policy flies with by default, and the hull that they assume."""

    applied: str = says.GUARDS_APPLIED
    radius: Above0
    height: Above0
    map: MapTerms | None = None
    evasion: EvasionTerms | None = None
    shield: ShieldTerms | None = None

    @classmethod
    def of(cls, settings: GuardSettings, vehicle: Vehicle) -> GuardTerms | None:
        """Return the part for some guards of a vehicle; None for no guards."""
        if not settings.names:
            return None
        plain = settings.plain()
        return cls(
            radius=vehicle.radius,
            height=vehicle.height,
            map=MapTerms(**plain["map"]) if "map" in plain else None,
            evasion=EvasionTerms(**plain["evasion"]) if "evasion" in plain else None,
            shield=ShieldTerms(**plain["shield"]) if "shield" in plain else None,
        )

    @property
    def settings(self) -> GuardSettings:
        """The guards as their settings."""
        shield = self.shield
        return GuardSettings(
            map=None if self.map is None else MapSettings(self.map.sight),
            evasion=None if self.evasion is None else EvasionSettings(self.evasion.sight, self.evasion.objects),
            shield=None if shield is None else ShieldSettings(shield.time, shield.lag, shield.margin, shield.nearest),
        )

    def contradiction(self) -> str | None:
        """Return what is not as this version of uavrl does it; None for a sound part."""
        if self.map is None or alike(self.map, MapTerms(sight=1.0), "reach", "cell", "level", "every", "ahead"):
            return None
        return "guards.map is another map"


class MemoryTerms(ContractPart):
    """What a network remembers from step to step: an input and an output more."""

    input: str
    output: str
    size: Size
    initial: float = 0.0
    does: str = says.MEMORY


class Network(ContractPart):
    """The file of the network."""

    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    opset: Annotated[int, Field(ge=1, le=1000)]
    input: str
    output: str
    memory: MemoryTerms | None = None  #: None for a network that remembers nothing


def rounded(numbers: np.ndarray) -> list[Any]:
    """Return an array as lists. A policy is trained with float32, of which nine digits are all there is."""
    listed: list[Any] = (np.round(numbers.astype(np.float32).astype(np.float64), 9) + 0.0).tolist()
    return listed


def alike(found: ContractPart, made: ContractPart, *names: str, rtol: float = 1e-6, atol: float = 0.0) -> bool:
    """Return whether these numbers of two parts are the same."""
    for pair in ((getattr(found, name), getattr(made, name)) for name in names):
        if None in pair:
            if pair != (None, None):
                return False
        elif np.shape(pair[0]) != np.shape(pair[1]) or not np.allclose(*pair, rtol=rtol, atol=atol):
            return False
    return True
