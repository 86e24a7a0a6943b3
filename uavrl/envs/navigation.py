"""The navigation task as a natively batched TorchRL environment."""

from collections.abc import Collection, Sequence
from copy import deepcopy
from functools import cached_property
from typing import Annotated, Literal, TypeVar

import numpy as np
import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Unbounded
from torchrl.envs import EnvBase

from uavrl.envs.controller import most_load
from uavrl.envs.difficulty import Difficulty, measure_tasks
from uavrl.envs.interface import checked_action, navigation_specs, quantities
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.limits import MaxSpeed, OrMapping, check_hull, require_speed, settings, whole
from uavrl.envs.mapped_way import MappedWays
from uavrl.envs.privileged import QUANTITIES, privileged
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.randomization import Randomization, draw_vehicles, require_flyable
from uavrl.envs.shortest_way import ShortestWays
from uavrl.envs.simulation import CONTROL_RATE, PHYSICS_RATE, Simulation
from uavrl.envs.traffic import Traffic, plane_mesh
from uavrl.envs.vehicle_params import VehicleParams
from uavrl.envs.world import World, WorldLike, draw_place, places_of, task_rng, world_rules
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.perception.goal import goal_distance
from uavrl_onboard.vehicle import VEHICLE

Hidden = Literal["planes"]
TICKS = PHYSICS_RATE // CONTROL_RATE  # physics steps in a step
_Made = TypeVar("_Made")


class NavigationEnv(EnvBase):
    """Quadrotors that fly to goals through a cluttered world, seeing only through a LiDAR, by default a VLP-16.

    The batch is native: ``num_uavs`` vehicles with tasks of their own fly in one PyBullet world, invisible to each
    other, and one Embree call casts all their rays (Chansuparp (2022), §4.1). A step is 0.1 s: 24 physics steps, then
    a scan. Actions ``(l_x, l_y, l_z, a_z)`` are the velocities in the yaw-aligned body frame (m/s) and the yaw rate
    (rad/s), each in [-``max_speed``, ``max_speed``]; the yaw rate is cut at 2 rad/s.

    It emits ``point_cloud`` (``[R, 3]``, m, sensor frame, NaN = no return; a VLP-16 has 28,928 rays), ``altitude`` (m),
    ``heading_deg`` and ``elevation_deg`` (the thesis's h and g), ``attitude`` (roll, pitch and yaw in rad), and for
    rewards, metrics and pictures ``distance``, ``position``, ``velocity`` (m/s, world axes), ``goal``, ``arrived``,
    ``collided``, ``world_seed`` and ``task``. Its own reward is the progress to the goal in metres; the thesis's
    rewards are transforms (:mod:`uavrl.transforms`).

    Task number ``k`` after ``set_seed(s)`` depends on ``(s, k)`` alone, so that two policies that are rolled out with
    one seed meet the same tasks (only a plane in the way moves a start); ``reset(task=k)`` goes on with task ``k``.
    ``set_seed`` also rebuilds physics and traffic at the next full reset: what follows is bit-identical to a new
    environment with that seed. Partial resets before that draw the new seed's tasks already.

    With ``randomize`` each task also has a vehicle of its own, which depends on ``(s, k)`` alone and leaves the rest of
    the task as it is; the controller goes by ``airframe`` and ``aerodynamics``. Its biases reach what the policy reads,
    ``altitude``, ``heading_deg`` and the yaw of ``attitude``, and with them the terms of Eq. 3.6 that are made of
    these; all else stays true.

    A copy, by ``copy`` or ``pickle``, has a PyBullet world of its own. It goes on from the same state, with the same
    tasks and noise, but repeats only up to rounding, which long episodes amplify.

    Configurations may also be dicts of their settings: ``world={"planes": 3}``.

    Args:
        num_uavs: number of vehicles N; the batch size is ``[N]``.
        world: where they fly, goals and planes: valleys, or any other world.
        lidar: the sensor, its range and its noise, for example ``{"sensor": "os0_32"}``.
        airframe: mass, inertia and limits of the vehicle.
        aerodynamics: drag, wind and gusts.
        randomize: what is drawn for the vehicle of each episode; None: nothing.
        max_speed: limit of each component of the velocity, m/s (Table 4.1: 2).
        max_steps: steps until an episode is truncated (Table 4.1: 300).
        blind: whether the LiDAR reports nothing at all, and casts nothing: altitude and angles are all that is left.
        blind_to: ``"planes"`` hides the planes from the LiDAR. They still collide.
        measure_clearance: also emit ``clearance``, the distance from the hull to the nearest thing, m.
        privileged: also emit these of :data:`uavrl.envs.privileged.QUANTITIES`, which critics and
            demonstrators may read.
        tasks: the tasks that count, in the order in which they are flown: valleys that none of these needs are not
            built. Vehicles that go on after the last of them have further tasks in the valleys that are. Planes, gusts
            and noise depend on the seed and on the first of them. None: all tasks from 0 on.
        seed: seed of tasks, traffic, gusts and sensor noise.
        device: where the outputs go. The simulation itself runs on the CPU.

    Raises:
        ValueError: for settings out of range, a world without solvable tasks, NaN actions, or a step after ``close``.

    Examples:
        >>> NavigationEnv(num_uavs=2).rollout(3)["next", "point_cloud"].shape
        torch.Size([2, 3, 28928, 3])
    """

    def __init__(
        self,
        num_uavs: Annotated[int, Field(ge=1, le=512)] = 8,
        *,
        world: WorldLike | None = None,
        lidar: OrMapping[LidarConfig] | None = None,
        airframe: OrMapping[Airframe] | None = None,
        aerodynamics: OrMapping[Aerodynamics] | None = None,
        randomize: OrMapping[Randomization] | None = None,
        max_speed: MaxSpeed = VEHICLE.velocity_limit,
        max_steps: Annotated[int, Field(ge=1, le=10**6)] = 300,
        blind: bool = False,
        blind_to: Hidden | None = None,
        measure_clearance: bool = False,
        privileged: Collection[str] = (),
        tasks: Sequence[int] | None = None,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        num_uavs, max_steps = whole("num_uavs", num_uavs, 1), whole("max_steps", max_steps, 1)
        if blind_to not in (None, "planes"):
            raise ValueError(f"blind_to must be None or 'planes', got {blind_to!r}.")
        super().__init__(device=device, batch_size=torch.Size([num_uavs]))
        self.num_uavs, self.max_steps = num_uavs, max_steps
        self.max_speed = require_speed(max_speed)
        self.blind = blind
        self.blind_to: Hidden | None = blind_to
        self.measure_clearance = measure_clearance
        self.privileged = tuple(privileged)
        if unknown := set(self.privileged) - set(QUANTITIES):
            raise UavrlError(f"privileged takes any of {', '.join(QUANTITIES)}, got {', '.join(sorted(unknown))}.")
        if tasks is not None and not (np.iterable(tasks) and len(tasks)):
            raise UavrlError(f"tasks takes a list of one task or more, or None for any, got {tasks!r}.")
        self._tasks = None if tasks is None else tuple(whole("tasks", task) for task in tasks)
        self._first, self._follower = _order(self._tasks)
        self.world_config = world_rules(world)
        self.airframe = settings("airframe", Airframe, airframe)
        self.aerodynamics = settings("aerodynamics", Aerodynamics, aerodynamics)
        drawn = settings("randomize", Randomization, randomize)
        self.randomize = drawn if drawn.is_on else None
        if self.randomize is not None:
            require_flyable(self.randomize, most_load(self.airframe))
        rules, hull = self.world_config, self.airframe
        check_hull(hull.collision_radius, hull.collision_height, max(rules.min_clearance, rules.uav_radius))
        self.lidar_config = settings("lidar", LidarConfig, lidar)
        self.lidar_sensor = self.lidar_config.device
        self.num_rays = self.lidar_sensor.num_rays
        self._lidar: Lidar | None = None
        self._simulation: Simulation | None = None
        self._traffic: Traffic | None = None
        self._ways: ShortestWays | None = None
        self._mapped: MappedWays | None = None
        self._goal = np.zeros((num_uavs, 3))
        self._place_of, self._world_seed, self._task, self._steps = np.zeros((4, num_uavs), dtype=np.int64)
        self.observation_spec, self.done_spec = navigation_specs(
            num_uavs, self.num_rays, self.device, clearance=measure_clearance, privileged=self.privileged
        )
        self.action_spec = Bounded(-self.max_speed, self.max_speed, (num_uavs, 4), self.device, torch.float32)
        self.reward_spec = Unbounded((num_uavs, 1), self.device, torch.float32)
        specs = {**self.observation_spec, "reward": self.reward_spec, **self.done_spec}
        self._dtypes = {key: spec.dtype for key, spec in specs.items()}
        self._seed = whole("seed", seed)
        self.set_seed(self._seed)
        self.is_closed = False  # TorchRL closes what says so, in collectors and when it is no longer needed

    def _set_seed(self, seed: int | None) -> None:
        seed = 0 if seed is None else whole("seed", seed)
        if self._tasks is not None and seed != self._seed:
            self._free()  # other valleys are needed
        self._seed = seed
        self._stale = True
        self._next_task = self._first

    def _rebuild(self, first: int) -> None:
        """Builds physics, traffic and generators anew from the seed; meshes and the ray-casting scene stay.

        So does a physics in which nothing has moved: a collector resets its environment before it is seeded.
        """
        seeds = np.random.SeedSequence(self._seed, spawn_key=(first,) if first else ()).spawn(3)
        traffic_rng, self._lidar_rng, gusts = map(np.random.default_rng, seeds)
        self._traffic, meshes, air = Traffic(self.world, traffic_rng), self.world.meshes, self.aerodynamics
        planes = len(self._traffic.legs)
        mesh = self._traffic.mesh if planes else None
        if self._simulation is not None and not self._simulation.restart(gusts):
            self._simulation.close()
            self._simulation = None
        if self._simulation is None:
            self._simulation = Simulation(
                meshes,
                self.num_uavs,
                airframe=self.airframe,
                aerodynamics=air,
                plane_mesh=mesh,
                plane_count=planes,
                max_speed=self.max_speed,
                rng=gusts,
            )
        if self._lidar is None and not self.blind:
            self._lidar = Lidar(meshes, mesh, self.lidar_config)
        self._ways = ShortestWays(self.world, self.num_uavs) if "way" in self.privileged else None
        if "mapped_way" in self.privileged:
            vehicle = self.airframe.vehicle(self.world_config.flight_level, self.max_speed)
            self._mapped = MappedWays(self.num_uavs, vehicle, self.lidar_config.farthest)
        self._next_task = self._first
        self._stale = False
        if planes:
            self._simulation.place_planes(self.plane_poses())

    @cached_property
    def world(self) -> World:
        """Places, goals and routes; built at the first use, which takes seconds."""
        needed = None if self._tasks is None else places_of(self.world_config, self._seed, self._tasks)
        try:
            return World(self.world_config, needed)
        except AttributeError as error:  # PyTorch would take it for a missing attribute "world", and hide this one
            raise RuntimeError(f"The world {type(self.world_config).__name__} cannot be built: {error}.") from error

    @property
    def tasks_begun(self) -> int:
        """The number of the next task. Without ``tasks`` it is how many were drawn since ``set_seed``."""
        return self._next_task

    def _reset(self, tensordict: TensorDictBase | None = None, *, task: int | None = None, **_: object) -> TensorDict:
        self._require_open()
        mask = np.ones(self.num_uavs, dtype=bool)
        if tensordict is not None and (reset := tensordict.get("_reset", None)) is not None:
            mask = reset.reshape(self.num_uavs).cpu().numpy()
        if self._simulation is None and not mask.all():
            raise RuntimeError("The first reset must be of all UAVs: reset the whole environment first.")
        if self._simulation is None or (self._stale and mask.all()):
            self._rebuild(self._first if task is None else 0)
        self._next_task = self._next_task if task is None else whole("task", task)
        index, nothing = np.flatnonzero(mask), np.zeros(self.num_uavs, dtype=bool)
        self._place(index, asked=task is not None)
        data = self._observe(index, nothing, nothing)
        return self._pack({**data, "done": nothing, "terminated": nothing, "truncated": nothing})

    def _task_rng(self, task: int) -> np.random.Generator:
        """What draws a task."""
        return task_rng(self._seed, task)

    def _spare_place(self, task: int) -> int | None:
        """The place, among those that were built, of a task after the last one that counts; None: its own."""
        if self._tasks is None or task in self._follower:
            return None
        drawn = draw_place(self.world_config, self._task_rng(task))
        return None if drawn in self.world.built else drawn % len(self.world.places)

    def difficulty(self, tasks: Sequence[int]) -> list[Difficulty | None]:
        """How hard tasks of the current seed are, wherever planes would move their starts to.

        It takes some milliseconds for each task in a valley, and a third of a second in a place of 200 by 200 m.
        """
        return measure_tasks(self.world, [self.world.sample_task(self._task_rng(task)) for task in tasks])

    def _place(self, index: np.ndarray, *, asked: bool) -> None:
        starts, yaws = np.zeros((len(index), 3)), np.zeros(len(index))
        for row, uav in enumerate(index):
            spare = None if asked else self._spare_place(self._next_task)
            task = self.world.sample_task(self._task_rng(self._next_task), spare, self.traffic.positions)
            starts[row], yaws[row] = task.start, task.yaw
            self._goal[uav], self._place_of[uav] = task.goal, task.place
            self._world_seed[uav], self._task[uav] = task.world_seed, self._next_task
            if self._ways is not None:
                self._ways.begin(int(uav), task.place, task.goal)
            self._next_task = self._follower.get(self._next_task, self._next_task + 1)
        self._steps[index] = 0
        if self._mapped is not None:
            self._mapped.begin(self._rows(index))
        tasks, most = self._task[index].tolist(), most_load(self.airframe)
        drawn = None if self.randomize is None else draw_vehicles(self.randomize, self._seed, tasks, most)
        self.simulation.reset(index, starts, yaws, drawn)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._require_open()
        action = checked_action(tensordict.get("action", None), self.num_uavs)
        distance_tm1 = goal_distance(self.simulation.position, self._goal)
        path = self.traffic.advance(TICKS, 1 / PHYSICS_RATE) if self.traffic.legs else None
        collided = self.simulation.step(action, path)
        collided |= self.world.out_of_bounds(self.simulation.position, self._place_of)
        arrived = self.world.arrived(self.simulation.position, self._goal) & ~collided
        self._steps += 1
        terminated = arrived | collided
        truncated = (self._steps >= self.max_steps) & ~terminated
        data = self._observe(np.arange(self.num_uavs), arrived, collided)
        ends = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        return self._pack({**data, "reward": distance_tm1 - data["distance"], **ends})

    def _observe(self, index: np.ndarray, arrived: np.ndarray, collided: np.ndarray) -> dict[str, np.ndarray]:
        """Quantities of all vehicles; only those in ``index`` scan, the clouds of the others stay empty."""
        data = {"point_cloud": self._scan(index), "arrived": arrived, "collided": collided}
        data |= {"world_seed": self._world_seed, "task": self._task}
        data |= quantities(self.simulation, self._goal, clearance=self.measure_clearance)
        if self._mapped is not None:
            data["mapped_way"] = self._mapped.directions(data, self._rows(index))
        if "traps" in self.privileged:
            data["traps"] = np.array([len(self.world.places[place].traps) for place in self._place_of])
        return data | privileged(self.privileged, self.simulation, self.traffic, self._ways)

    def _rows(self, index: np.ndarray) -> np.ndarray:
        """Which vehicles an index names, ``bool [N]``."""
        return np.isin(np.arange(self.num_uavs), index)

    def _built(self, made: _Made | None) -> _Made:
        self._require_open()
        if made is None:
            raise RuntimeError("Reset the environment first: before that it has no simulation and no planes.")
        return made

    @property
    def simulation(self) -> Simulation:
        """The physics, with attitudes, sensor positions and more; there is none before the first reset."""
        return self._built(self._simulation)

    @property
    def vehicle_params(self) -> tuple[VehicleParams, ...]:
        """The N vehicles as they are in their episodes; there are none before the first reset."""
        return tuple(self.simulation.params.each)

    @property
    def traffic(self) -> Traffic:
        """The planes on their ways; there are none before the first reset."""
        return self._built(self._traffic)

    def plane_poses(self) -> np.ndarray:
        """Returns x, y, z in m and yaw in rad of all planes, ``[K, 4]``."""
        return self.traffic.poses()

    def plane_paths(self, steps: int) -> np.ndarray:
        """Returns where all planes will be after each of the next steps: x, y, z in m and yaw in rad, ``[T, K, 4]``.

        It copies the traffic, which takes some milliseconds.
        """
        return deepcopy(self.traffic).advance(steps * TICKS, 1 / PHYSICS_RATE)[TICKS - 1 :: TICKS]

    @property
    def plane_mesh(self) -> Mesh:
        """The shape of a plane at the origin, x forward, in m; :meth:`plane_poses` says where each one is."""
        return plane_mesh(self.world_config.plane_wingspan)

    def look(self, rays: slice, number: int | None = None) -> np.ndarray:
        """What all vehicles see now by some rays: ``[N, R, 3]``, NaN for all other rays and for misses.

        Of a pattern that changes they are the rays of the scan ``number``, or of that of this step.
        """
        numbers = None if number is None else np.full(self.num_uavs, number)
        return self._scan(np.arange(self.num_uavs), rays, numbers)

    def _scan(self, index: np.ndarray, rays: slice | None = None, numbers: np.ndarray | None = None) -> np.ndarray:
        if self._lidar is None:
            return self._no_returns
        planes = self.plane_poses() if self.world.config.planes and self.blind_to != "planes" else None
        if numbers is None:
            numbers = self._task[index] + self._steps[index]  # of a pattern that changes: its own in each task
        points = self.simulation.scan(self._lidar, index, planes, self._lidar_rng, rays, numbers)
        if len(index) == self.num_uavs:
            return points
        cloud = self._no_returns.copy(order="K")
        cloud[index] = points
        return cloud

    @cached_property
    def _no_returns(self) -> np.ndarray:
        """The clouds of the blind: filled once, and the same array after every step."""
        return np.full((3, self.num_uavs, self.num_rays), np.nan, dtype=np.float32).transpose(1, 2, 0)  # as a scan lies

    def _pack(self, data: dict[str, np.ndarray]) -> TensorDict:
        tensors = {}
        for key, values in data.items():
            if key != "point_cloud":  # which is fresh and float32 already: the others are small, and copied
                values = np.array(values if values.ndim > 1 else values[:, None])
            tensors[key] = torch.as_tensor(values, dtype=self._dtypes[key], device=self.device)
        return TensorDict(tensors, batch_size=self.batch_size, device=self.device)

    def __copy__(self) -> "NavigationEnv":
        """Return an independent copy, as ``deepcopy`` does: a physics cannot be shared."""
        return deepcopy(self)

    def _require_open(self) -> None:
        if self.is_closed:
            raise UavrlError("The environment is closed and has freed its simulation: make a new one.")

    def _free(self) -> None:
        """Frees the PyBullet world, the ray-casting scene and the valleys."""
        if self._simulation is not None:
            self._simulation.close()
        self._simulation = self._lidar = self._traffic = self._ways = self._mapped = None
        for made in ("world", "_no_returns"):
            self.__dict__.pop(made, None)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Frees all that was built and closes the environment: it takes no step or reset any more."""
        self._free()
        super().close(raise_if_closed=raise_if_closed)


def _order(tasks: Sequence[int] | None) -> tuple[int, dict[int, int]]:
    """The first of some tasks, and the one that follows on each of them: behind the last, the next of all numbers."""
    if tasks is None:
        return 0, {}
    return tasks[0], dict(zip(tasks, [*tasks[1:], max(tasks) + 1], strict=True))
