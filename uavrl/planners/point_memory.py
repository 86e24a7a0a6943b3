"""What vehicles remember of their own scans: the returns of the last seconds, moved by odometry."""

from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from uavrl.envs.limits import OrMapping, settings
from uavrl.envs.quadrotor import GRAVITY, Airframe
from uavrl.policies.baselines import wrapped_heading
from uavrl.policy_protocol import PolicyModule
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import NEAREST_RETURN, body_to_level, body_to_world, world_to_yaw
from uavrl_onboard.guards.evade import evaded
from uavrl_onboard.guards.histogram import polar_histogram
from uavrl_onboard.lidar.vlp16 import NUM_RAYS
from uavrl_onboard.perception.cells import LASERS
from uavrl_onboard.perception.motion.occlusion import Grid, Returns, find_returns, least_around, range_images
from uavrl_onboard.perception.motion.threats import STEPS, straight_on
from uavrl_onboard.vehicle import VEHICLE

PERIOD = VEHICLE.period  # s between two scans
THINNED = 4  # of a VLP-16's firing cycles, 0.2 degrees apart, one of so many is read
READ = 7_000  # rays, about, that are read of a scan of any other sensor
MARGIN = 0.3  # m, by which a scan must see farther than a remembered point to forget it
TALL = 0.8  # height of what is remembered over its width: scans lie within 15 degrees, and 30 of tilt
NEVER = -(2**30)  # a scan's number before all others
GAIN = torch.tensor(
    [2.4, 2.4, 3.0], dtype=torch.float32
)  # 1/s, acceleration over what a velocity lacks; fitted to flights, as the next
LEAN = torch.tensor(
    [0.41, 0.41, 0.63], dtype=torch.float32
)  # share of what the acceleration lacks that comes in a step
TURN_GAIN, TURN_LIMIT = 0.6, 1.0  # 1/s and rad/s; a fast turn makes a late command point elsewhere


def thinned(clouds: Tensor) -> Tensor:
    """Return the rays of scans ``[N, R, 3]`` that are read, evenly over the beams.

    Examples:
        >>> thinned(torch.zeros(2, 28928, 3)).shape, thinned(torch.zeros(2, 65536, 3)).shape
        (torch.Size([2, 7232, 3]), torch.Size([2, 7282, 3]))
    """
    count = clouds.shape[1]
    if count == NUM_RAYS:
        return clouds.unflatten(1, (-1, LASERS))[:, ::THINNED].flatten(1, 2)
    return clouds[:, :: max(1, count // READ) | 1]  # an odd step leaves out no beam of 2^k


class ScanMemory:
    """The returns of the last scans of N vehicles, thinned to one in a cube, the newest.

    A vehicle knows its place since the episode's start by its own velocity, integrated from scan to scan. What a later
    scan sees through is forgotten, as Baumann (2018), section 3.2, lets the new scan decide where it looks. The cubes
    are a ring around each vehicle: what lies farther away is overwritten by what is near.

    Args:
        sight: how far returns count, m.
        seconds: for which they are remembered.
        cube: edge of a cube, m.
        above: where the LiDAR sits, m over the hull's middle.

    Examples:
        A point ahead and above is seen once, and remembered where it is while the vehicle flies on at 1 m/s:

        >>> memory, cloud = ScanMemory(), np.full((1, 2, 3), np.nan, np.float32)
        >>> cloud[0, 0] = [2.0, 0.0, 1.9]
        >>> at_1 = {"velocities": np.array([[1.0, 0, 0]]), "attitudes": np.zeros((1, 3))}
        >>> for step in range(3):
        ...     memory.look(cloud if step == 0 else 0 * cloud, fresh=np.array([step == 0]), **at_1)
        >>> memory.recall()[0].round(3)
        array([[1.8, 0. , 2. ]])
    """

    def __init__(
        self, sight: float = 4.0, seconds: float = 10.0, cube: float = 0.15, above: float = VEHICLE.lidar_above
    ) -> None:
        self.sight, self.seconds, self.cube, self.above = sight, seconds, cube, above
        wide = int(np.ceil(2.2 * sight / cube))
        self._shape = np.array([wide, wide, int(np.ceil(TALL * wide))])
        self._grid, self._now = Grid(), 0
        self._begin(0)

    def _begin(self, count: int) -> None:
        """Makes room for so many vehicles."""
        cubes = int(self._shape.prod())
        self._stamps = np.full(count * cubes, NEVER, np.int32)
        self._points = np.zeros((count * cubes, 3), np.float32)  # since the episode's start, world axes
        self.places, self._velocities = np.zeros((2, count, 3))

    def look(self, clouds: np.ndarray, velocities: np.ndarray, attitudes: np.ndarray, fresh: np.ndarray) -> None:
        """Takes in another scan of each vehicle.

        Args:
            clouds: ``[N, R, 3]``, m, sensor axes.
            velocities: ``[N, 3]``, m/s, world axes.
            attitudes: ``[N, 3]``, roll, pitch and yaw in rad.
            fresh: ``bool [N]``, whose episode begins: it has seen nothing before.
        """
        count = len(clouds)
        if len(self.places) != count:
            self._begin(count)
        self._stamps.reshape(count, -1)[fresh] = NEVER
        self.places += np.where(fresh[:, None], -self.places, PERIOD * (velocities + self._velocities) / 2)
        self._velocities, self._now = velocities, self._now + 1
        turns, seen = body_to_world(attitudes).astype(np.float32), find_returns(clouds, self.sight)
        sensors = self.places + self.above * turns[:, :, 2]
        self._forget(seen, turns, sensors)
        world = np.einsum("mij,jm->mi", turns[seen.clouds], seen.points) + sensors[seen.clouds]
        ring = np.floor(world / self.cube).astype(np.int64) % self._shape
        cell = ((seen.clouds * self._shape[0] + ring[:, 0]) * self._shape[1] + ring[:, 1]) * self._shape[2] + ring[:, 2]
        self._stamps[cell], self._points[cell] = self._now, world

    def _known(self) -> tuple[np.ndarray, np.ndarray]:
        """Which cubes hold a point that is young enough, and whose they are: ``[M]`` each."""
        known = np.flatnonzero(self._stamps > self._now - max(round(self.seconds / PERIOD), 1))
        return known, known // int(self._shape.prod())

    def _forget(self, seen: Returns, turns: np.ndarray, sensors: np.ndarray) -> None:
        """Drops what the scans ``seen`` by sensors at ``[N, 3]``, turned by ``[N, 3, 3]``, see through."""
        known, owners = self._known()
        if not len(known):
            return
        images = least_around(range_images(seen, len(sensors), self._grid))
        apart = (self._points[known] - sensors[owners]).astype(np.float32)
        points = np.einsum("mji,mj->im", turns[owners], apart)
        ranges = np.sqrt((points * points).sum(0))
        row, column = self._grid.cells(points, np.maximum(ranges, NEAREST_RETURN))
        inside = (row >= 0) & (row <= self._grid.rows - 1) & (ranges < self.sight - MARGIN)
        least = images[owners, np.rint(row).astype(np.int64).clip(0, self._grid.rows - 1), column]
        self._stamps[known[inside & (least > ranges + MARGIN)]] = NEVER

    def recall(self) -> tuple[np.ndarray, np.ndarray]:
        """What is remembered within sight: ``[M, 3]`` m from the hull's middle, world axes, and whose it is ``[M]``."""
        known, owners = self._known()
        apart = self._points[known] - self.places[owners]
        near = (apart * apart).sum(1) < self.sight**2
        return apart[near], owners[near]


class Surroundings(NamedTuple):
    """What a planner knows; vectors in axes that are level and point where the vehicle's yaw does."""

    points: list[Tensor]  #: of each vehicle the nearest obstacles by direction, ``[P, 3]``, m from the hull's middle
    velocity: Tensor  #: ``[N, 3]`` m/s
    acceleration: Tensor  #: ``[N, 3]`` m/s², that of the tilt
    carried: Tensor  #: ``[N, 3]`` m, to where it would come to rest from now on
    goal: Tensor  #: unit vectors ``[N, 3]`` to the goal's axis, level
    altitude: Tensor  #: ``[N, 1]`` m
    fresh: Tensor  #: ``bool [N, 1]``, whether the episode begins
    turn: Tensor  #: yaw rates ``[N, 1]`` in rad/s that slowly turn to the goal
    cloud: list[Tensor]  #: all that each vehicle remembers within sight, ``[M, 3]``, m from the hull's middle
    place: Tensor  #: ``[N, 3]`` m since the episode's start by its own velocity, world axes
    yaw: Tensor  #: ``[N]`` rad
    ways: Tensor  #: where K moving objects will be in the next two seconds, ``[N, K, T, 3]``, m from the hull's middle
    known: Tensor  #: ``bool [N, K]``, which of them there are


def tilt_acceleration(attitude: Tensor) -> Tensor:
    """Level accelerations ``[N, 3]`` in m/s² that hold at roll, pitch and yaw ``[N, 3]``, in the axes of the yaw.

    Examples:
        >>> tilt_acceleration(torch.tensor([[0.0, 0.1, 0.5], [0.1, 0.0, 0.5]])).round(decimals=2)
        tensor([[ 0.9800, -0.0000,  0.0000],
                [ 0.0000, -0.9800,  0.0000]])
    """
    roll, pitch, _ = attitude.unbind(-1)
    return GRAVITY * torch.stack([pitch.tan(), -roll.tan() / pitch.cos(), torch.zeros_like(roll)], -1)


class Planner(PolicyModule):
    """A policy that flies by what it remembers of its scans; a class of it says how (``steer``).

    Args:
        flight_level: altitude to hold where nothing is in the way, m.
        sight: how far returns count, m.
        seconds: for which they are remembered.
        motion: how far moving objects are looked for, to keep out of their ways; None: it is not told of any.
        airframe: whose hull and LiDAR it reckons with; None for the default one.
        max_speed: limit of each component of the velocity, m/s.
    """

    def __init__(
        self,
        flight_level: float,
        sight: float,
        seconds: float,
        motion: float | None = None,
        airframe: OrMapping[Airframe] | None = None,
        max_speed: float = VEHICLE.velocity_limit,
    ) -> None:
        super().__init__()
        self.in_keys = ["point_cloud", "is_init", "altitude", "heading_deg", "velocity", "attitude"]
        self.in_keys += ["moving_objects"] if motion is not None else []
        self.motion = motion
        self.out_keys = ["action"]
        self.vehicle = settings("airframe", Airframe, airframe).vehicle(flight_level, max_speed)
        self.memory = ScanMemory(sight, seconds, above=self.vehicle.lidar_above)

    # It demonstrates for one vehicle only: at the end of an episode it would be asked twice for the others.
    one_vehicle = True

    def steer(self, seen: Surroundings) -> tuple[Tensor, Tensor]:
        """The velocities to fly at, ``[N, 3]`` m/s, and the yaw rates ``[N, 1]`` in rad/s."""
        raise NotImplementedError

    def evade(self, velocity: Tensor, seen: Surroundings) -> Tensor:
        """The velocities ``[N, 3]`` in place of planned ones that lead into the way of what moves."""
        height = seen.altitude - self.vehicle.flight_level
        told = (seen.velocity, seen.ways, seen.known, seen.points, height, self.vehicle)
        return torch.as_tensor(call_numpy(evaded, velocity, *told))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``, each component within its limits, and remembers the scan."""
        seen = self._survey(tensordict)
        velocity, turn = self.steer(seen)
        action = torch.cat([self.evade(velocity, seen), turn], -1)
        return tensordict.set("action", action.clamp(-self.vehicle.velocity_limit, self.vehicle.velocity_limit))

    def _survey(self, tensordict: TensorDictBase) -> Surroundings:
        """Takes in one step of all vehicles."""
        fresh, attitude = tensordict["is_init"], tensordict["attitude"]
        velocity, yaw = tensordict["velocity"], attitude[:, 2]
        cloud = thinned(tensordict["point_cloud"])
        call_numpy(self.memory.look, cloud, velocity.double(), attitude.double(), fresh[:, 0])
        points, owners = self.memory.recall()
        level = world_to_yaw(points.astype(np.float32), yaw.numpy()[owners])
        heading = wrapped_heading(tensordict["heading_deg"])
        flown, tilted = call_numpy(world_to_yaw, velocity, yaw), tilt_acceleration(attitude)
        return Surroundings(
            call_numpy(polar_histogram, level, owners, len(yaw)),
            flown,
            tilted,
            (flown + PERIOD * (1 / LEAN - 1) * tilted) / GAIN,
            torch.cat([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1),
            tensordict["altitude"],
            fresh,
            (TURN_GAIN * heading).clamp(-TURN_LIMIT, TURN_LIMIT),
            call_numpy(np.split, level, np.searchsorted(owners, np.arange(1, len(yaw)))),
            torch.from_numpy(self.memory.places),
            yaw,
            *self._moving(tensordict),
        )

    def _moving(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """The ways of what moves, as if it flew straight on, and which there are; none where it is not told of any."""
        if self.motion is None:
            count = len(tensordict["is_init"])
            return torch.zeros(count, 0, STEPS, 3, dtype=torch.float32), torch.zeros(count, 0, dtype=torch.bool)
        ways, known = call_numpy(straight_on, tensordict["moving_objects"])  # from the LiDAR
        tilts = body_to_level(tensordict["attitude"].double().numpy())
        sensor = self.memory.above * torch.from_numpy(tilts[:, :, 2]).to(ways)
        return ways + sensor[:, None, None], known
