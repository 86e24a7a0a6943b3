"""Quadrotors, static geometry and moving planes in one PyBullet world."""

import weakref
from collections.abc import Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np

from uavrl.envs.bullet import STATIC, Clearance, add_fixed, add_vehicle, connect, place_body, pybullet
from uavrl.envs.controller import VelocityController, feasible_command
from uavrl.envs.limits import OrMapping, settings
from uavrl.envs.plane_bodies import PlaneBodies
from uavrl.envs.quadrotor import (
    GRAVITY,
    Aerodynamics,
    Airframe,
    drag,
    gust_path,
    mixing_matrix,
)
from uavrl.envs.state_history import StateHistory
from uavrl.envs.vehicle_params import FleetParams, VehicleParams
from uavrl.errors import UavrlError
from uavrl_onboard.geometry import quaternion, rotations_of
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.vehicle import VEHICLE

if TYPE_CHECKING:
    from uavrl.envs.lidar import Lidar

CONTROL_RATE = round(VEHICLE.control_rate)  # Hz
PHYSICS_RATE = 240  # Hz
TRACKING_PERIOD = 3  # physics steps per step of the controller's outer loop: 80 Hz; 1 where it does not divide
CONTACT_DISTANCE = 1e-3  # m: Bullet stops a body where it touches, within rounding, before it penetrates
_IN_BULLET = ("_client", "_disconnect", "_statics", "_planes", "_vehicles", "_clearance", "_row")  # made by _build


class Simulation:
    """N quadrotors in one PyBullet world (Chansuparp (2022), §2.1): they touch geometry and planes, never each other.

    Gravity, rigid-body motion and contacts are Bullet's; rotors, drag and control are ours, at the physics rate. All
    quantities are ``float64`` numpy arrays in SI units, new ones after every reset and step.

    A copy, by ``copy`` or ``pickle``, gets a PyBullet world of its own and moves on from the same state, up to rounding
    (1e-15). Bullet remembers forces of contacts from one step to the next, and a copy does not: vehicles that touch
    something when they are copied may move on differently.

    Args:
        meshes: Static geometry.
        count: Number of vehicles N.
        airframe: The vehicle.
        aerodynamics: Drag, wind and gusts.
        plane_mesh: Shape of the planes, x forward; needed when ``plane_count`` is above 0.
        plane_count: Number of planes K.
        physics_rate: Physics steps per second.
        control_rate: Calls of :meth:`step` per second; divides the physics rate.
        max_speed: Limit of each component of the velocity in m/s.
        rng: Source of the gusts; needed when they are on.

    Attributes:
        position: ``[N, 3]``, the geometric centre of each airframe in m.
        velocity: ``[N, 3]``, its velocity in m/s.
        rotation: ``[N, 3, 3]``, body to world.
        yaw: ``[N]`` in rad, in [-π, π].
        angular_velocity: ``[N, 3]``, rates in body axes in rad/s.
        lidar_position: ``[N, 3]``, the LiDAR's centre in m.
        rotor_speed: ``[N, 4]`` in rad/s.
        motors_on: Set it to False to stop all rotors at once.
        params: The vehicles as they are; the controller believes in ``airframe`` and ``aerodynamics``.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh],
        count: int,
        *,
        airframe: OrMapping[Airframe] | None = None,
        aerodynamics: OrMapping[Aerodynamics] | None = None,
        plane_mesh: Mesh | None = None,
        plane_count: int = 0,
        physics_rate: int = PHYSICS_RATE,
        control_rate: int = CONTROL_RATE,
        max_speed: float = VEHICLE.velocity_limit,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.airframe = settings("airframe", Airframe, airframe)
        self.aerodynamics = settings("aerodynamics", Aerodynamics, aerodynamics)
        if count < 1 or physics_rate % control_rate:
            raise ValueError(
                f"A simulation takes at least 1 vehicle and a control rate that divides the physics rate, "
                f"got {count} vehicles, {control_rate} Hz and {physics_rate} Hz."
            )
        if plane_count and plane_mesh is None:
            raise ValueError(f"{plane_count} planes need a shape: pass plane_mesh.")
        self.count, self.substeps, self._dt = count, physics_rate // control_rate, 1 / physics_rate
        self._limits = np.array([max_speed] * 3 + [VEHICLE.yaw_rate_limit])  # of commands
        self._tracking_period = TRACKING_PERIOD if self.substeps % TRACKING_PERIOD == 0 else 1
        self.motors_on, self._rng, self._has_moved = True, rng, False
        self._history = StateHistory(count, plane_count, self.substeps)
        self._prepare_model()
        self._contents = list(meshes), plane_mesh, plane_count
        self._build()
        self.reset(np.arange(count), np.zeros((count, 3)), np.zeros(count))

    def _prepare_model(self) -> None:
        """Keeps what every physics step needs as arrays."""
        airframe, aerodynamics = self.airframe, self.aerodynamics
        self._controller = VelocityController(self.count, airframe, aerodynamics)
        self.params = FleetParams(self.count, airframe, aerodynamics, self._dt, self._tracking_period)
        self._mixing = np.ascontiguousarray(airframe.thrust_coefficient * mixing_matrix(airframe).T)
        self._centre_of_mass = np.array(airframe.centre_of_mass)
        self._lidar_offset = np.array(airframe.lidar_position)
        self._gust = np.zeros((self.count, 3))
        self._targets = np.zeros((self.substeps // self._tracking_period + 1, self.count, 4))  # oldest first
        self.rotor_speed = np.full((self.count, 4), airframe.hover_speed)

    def _build(self) -> None:
        """Connects and fills the world."""
        meshes, plane_mesh, plane_count = self._contents
        self._client = connect()
        if self._client < 0:
            raise RuntimeError("PyBullet gave no physics client: close simulations that are no longer needed.")
        self._disconnect = weakref.finalize(self, pybullet.disconnect, physicsClientId=self._client)
        pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=self._client)
        exact = {"fixedTimeStep": self._dt, "deterministicOverlappingPairs": 1}
        pybullet.setPhysicsEngineParameter(**exact, physicsClientId=self._client)
        self._statics = [add_fixed(self._client, part, STATIC) for mesh in meshes for part in mesh.split()]
        self._planes = PlaneBodies(self._client, plane_mesh, plane_count)
        self._vehicles = [add_vehicle(self._client, self.airframe) for _ in range(self.count)]
        self._clearance = Clearance(self._client, meshes, self._statics, self._planes.bodies, self.airframe)
        self._row = {body: row for row, body in enumerate(self._vehicles)}

    def reset(
        self, index: np.ndarray, positions: np.ndarray, yaws: np.ndarray, params: Sequence[VehicleParams] | None = None
    ) -> None:
        """Places vehicles ``int [M]`` at ``[M, 3]`` m with yaws ``[M]`` rad: level, at rest, hovering, without gusts.

        They are as the M ``params`` say; None leaves them as they were.
        """
        if params is not None:
            self._rebuild(index, params)
        if self.params.gusty and self._rng is None:
            raise ValueError("Gusts need a source of randomness: pass rng.")
        for row, centre, yaw in zip(index, positions + self._centre_of_mass, yaws, strict=True):
            w, *axis = quaternion(0.0, 0.0, yaw)
            place_body(self._client, self._vehicles[row], centre, (*axis, w))
        self.rotor_speed[index] = self.params.hover_speed[index]
        self._gust[index] = self._targets[:, index] = 0.0
        self._controller.reset(index, self.params.hover_force[index])
        self._history.reset(index, self._read())
        self._publish()
        self._planes.bring(self.position)

    def restart(self, rng: np.random.Generator) -> bool:
        """Takes another source of the gusts, as a new one would; False if it has moved: Bullet remembers contacts.

        All vehicles must be reset next, and the planes placed.
        """
        if self._has_moved:
            return False
        self.motors_on, self._rng = True, rng
        return True

    def _rebuild(self, index: np.ndarray, params: Sequence[VehicleParams]) -> None:
        """Gives vehicles the masses of their params, and keeps the rest."""
        self.params.put(index, params)
        self._weigh(index)

    def _weigh(self, index: np.ndarray) -> None:
        """Gives bodies the masses of their params."""
        for row in index:
            mass, inertia = float(self.params.mass[row]), self.params.inertia[row].tolist()
            changed = {"mass": mass, "localInertiaDiagonal": inertia, "physicsClientId": self._client}
            pybullet.changeDynamics(self._vehicles[row], -1, **changed)

    def place_planes(self, poses: np.ndarray) -> None:
        """Puts the planes at ``poses [K, 4]``: x, y, z in m and yaw in rad."""
        self._planes.place(self._checked_poses(poses, (len(self._planes.bodies), 4)), self.position)
        self._history.place_planes(poses)

    def step(
        self, commands: np.ndarray, plane_path: np.ndarray | None = None, substeps: int | None = None
    ) -> np.ndarray:
        """Runs one control period; returns which vehicles touched anything in any of its physics steps, ``bool [N]``.

        Args:
            commands: ``[N, 4]``: velocities in the yaw-aligned body frame in m/s and yaw rate in rad/s, clipped to
                their limits.
            plane_path: ``[substeps, K, 4]``: x, y, z in m and yaw in rad of the planes in each physics step.
            substeps: physics steps, if this is a part of a period: a multiple of 3. Parts and a whole come to the same.
        """
        substeps, self._has_moved = self._checked_substeps(substeps), True
        target = feasible_command(self._checked_commands(commands), self.airframe, self.aerodynamics)
        shape = (substeps, len(self._planes.bodies), 4)
        if plane_path is None:
            self._planes.bring(self.position)
        else:
            self._planes.begin(self._checked_poses(plane_path, shape), self.position)
        self._history.begin(substeps, plane_path)
        wind = self._draw_wind(substeps)
        touched, period = np.zeros(self.count, dtype=bool), self._tracking_period * self._dt
        for substep in range(substeps):
            if plane_path is not None:
                self._planes.move(substep)
            if substep % self._tracking_period == 0:
                lift = self.airframe.thrust_coefficient * np.add.reduce(self.rotor_speed * self.rotor_speed, axis=1)
                velocity = self._twist_world[:, 0]
                self._controller.track(self._delayed(target), self.rotation, velocity, self._twist, lift, period)
            self._push(None if wind is None else wind[substep])
            pybullet.stepSimulation(physicsClientId=self._client)
            self._history.add(self._read())
            for contact in pybullet.getContactPoints(physicsClientId=self._client):
                if contact[8] <= CONTACT_DISTANCE:
                    touched[[self._row[body] for body in contact[1:3] if body in self._row]] = True
        self._publish()
        return touched

    def _checked_substeps(self, substeps: int | None) -> int:
        substeps = self.substeps if substeps is None else substeps
        if not 0 < substeps <= self.substeps or substeps % self._tracking_period:
            most = f"a multiple of {self._tracking_period}, at most {self.substeps}"
            raise ValueError(f"A part of a control period has physics steps, {most}, got {substeps}.")
        return substeps

    def _delayed(self, target: np.ndarray) -> np.ndarray:
        """The commands ``[N, 4]`` that act when ``target [N, 4]`` has just been given, each as late as its vehicle."""
        delay = self.params.action_delay[:, 0] // self._tracking_period
        if not delay.any():
            return target
        self._targets = np.concatenate([self._targets[1:], target[None]])
        return self._targets[-1 - delay, np.arange(self.count)]

    def _checked_commands(self, commands: np.ndarray) -> np.ndarray:
        commands = np.asarray(commands, dtype=np.float64)
        if commands.shape != (self.count, 4):
            raise ValueError(f"Commands must have the shape ({self.count}, 4), got {commands.shape}.")
        if np.isnan(commands).any():
            raise UavrlError("Actions must be numbers, got NaN: check the policy, whose training may have diverged.")
        return np.clip(commands, -self._limits, self._limits)

    @staticmethod
    def _checked_poses(poses: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Poses as float64, of which there must be as many."""
        poses = np.asarray(poses, dtype=np.float64)
        if poses.shape != shape:
            raise ValueError(f"Poses of planes must have the shape {shape}, got {poses.shape}.")
        return poses

    def _read(self) -> np.ndarray:
        """Reads all states ``[N, 13]``; Bullet gives the centre of mass, and velocities in world axes."""
        client = self._client
        entries: list[float] = []
        for body in self._vehicles:
            position, attitude = pybullet.getBasePositionAndOrientation(body, client)
            linear, angular = pybullet.getBaseVelocity(body, client)
            entries += position + attitude + linear + angular
        state = np.array(entries).reshape(-1, 13)
        self._centre = state[:, :3]
        self._twist_world = state[:, 7:].reshape(-1, 2, 3)
        self.rotation = rotations_of(state[:, 3:7])
        self._twist = np.matmul(self._twist_world, self.rotation)  # rows times R = Rᵀ times columns: body axes
        return state

    def _push(self, wind: np.ndarray | None) -> None:
        """Runs the inner loop and the rotors, and applies thrust, drag and moments at the centres of mass."""
        if self.motors_on:
            wanted = np.sqrt(self._controller.thrusts(self.rotation, self._twist) / self.airframe.thrust_coefficient)
            self.rotor_speed += self.params.motor_gain * (wanted - self.rotor_speed)
        else:
            self.rotor_speed[:] = 0.0
        wrench = (self.rotor_speed * self.rotor_speed) @ self._mixing
        if self.params.thrust is not None:
            wrench *= self.params.thrust
        twist = self._twist  # relative to the air, and rates
        if wind is not None:
            twist = twist.copy()
            twist[:, 0] -= np.matmul(wind[:, None], self.rotation)[:, 0]
        loads = drag(twist, self.params.drag, self.params.drag_limit)
        loads[:, 0, 2] += wrench[:, 0]
        loads[:, 1] += wrench[:, 1:]
        # Both in world axes and at the centre of mass, where PyBullet's frames leave no doubt.
        loads = np.matmul(loads, self.rotation.transpose(0, 2, 1))
        client, frame = self._client, pybullet.WORLD_FRAME
        for body, centre, (force, moment) in zip(self._vehicles, self._centre.tolist(), loads.tolist(), strict=True):
            pybullet.applyExternalForce(body, -1, force, centre, frame, client)
            pybullet.applyExternalTorque(body, -1, moment, frame, client)

    def _draw_wind(self, substeps: int) -> np.ndarray | None:
        """Draws the wind ``[T, N, 3]`` in m/s, world axes, of T physics steps; None in still air."""
        params, gusts = self.params, self._gust[None]
        if params.still_air:
            return None
        if params.gusty and self._rng is not None:
            intensity, time_constant = params.gust_intensity, self.aerodynamics.gust_time_constant
            gusts = gust_path(self._gust, intensity, time_constant, self._dt, substeps, self._rng)
            self._gust = gusts[-1]
        return np.broadcast_to(params.wind + gusts, (substeps, self.count, 3))

    def _publish(self) -> None:
        """Turns the last state into the public quantities."""
        rotation = self.rotation
        arm = rotation @ self._centre_of_mass  # from the geometric centre to the centre of mass
        linear, angular = self._twist_world[:, 0], self._twist_world[:, 1]
        self.position = self._centre - arm
        self.velocity = linear - np.cross(angular, arm)
        self.angular_velocity = self._twist[:, 1].copy()
        self.yaw = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
        self.lidar_position = self.position + rotation @ self._lidar_offset

    def scan(
        self,
        lidar: "Lidar",
        index: np.ndarray,
        planes: np.ndarray | None,
        rng: np.random.Generator,
        rays: slice | None = None,
        numbers: np.ndarray | None = None,
    ) -> np.ndarray:
        """Returns the newest scans of the vehicles ``int [M]``, as :meth:`uavrl.envs.Lidar.scan` gives them.

        Of some ``rays`` alone it gives what the sensor sees now, without motion distortion.
        """
        position, rotation, velocity = self.lidar_position[index], self.rotation[index], self.velocity[index]
        spin = (rotation @ self.angular_velocity[index][:, :, None])[:, :, 0]
        delay = self._history.since_reset(self.params.scan_delay[index], index)
        if delay.any():
            position, rotation, velocity, spin = self._at_lidar(self._history.states(delay, index))
            planes = None if planes is None else self._history.planes(delay)
        if lidar.config.motion_distortion and rays is None:  # the scan is the spin that ends now
            from scipy.spatial.transform import Rotation  # here, so that it is PyBullet that is missed first

            position = position - velocity / lidar.sensor.rate
            rotation = Rotation.from_rotvec(-spin / lidar.sensor.rate).as_matrix() @ rotation
        if self.params.mount is not None:
            rotation = rotation @ self.params.mount[index]
        flaws = [self.params.each[row] for row in index] if self.params.flawed else None
        motion = {"velocities": velocity, "angular_velocities": spin}
        return lidar.scan(position, rotation, planes, **motion, rng=rng, flaws=flaws, rays=rays, numbers=numbers)

    def _at_lidar(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where LiDARs are in states ``[M, 13]``, how they stand and move: as :meth:`_publish` says it of now."""
        rotation, linear, angular = rotations_of(state[:, 3:7]), state[:, 7:10], state[:, 10:]
        arm = rotation @ self._centre_of_mass
        position = state[:, :3] - arm + rotation @ self._lidar_offset
        return position, rotation, linear - np.cross(angular, arm), angular

    def closest_distance(self) -> np.ndarray:
        """Returns ``[N]``: m from each hull to the nearest geometry or plane, at most 5; below 0 inside."""
        self._planes.bring(self.position)
        return self._clearance.distances(self._vehicles, self.position)

    def __copy__(self) -> "Simulation":
        """Return an independent copy: two simulations cannot share arrays and have two worlds."""
        return deepcopy(self)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is in PyBullet; :attr:`_past` has the vehicles' states, and the planes have poses."""
        if self._client < 0:
            raise UavrlError("A simulation that was closed cannot be copied or pickled: make a new one.")
        kept = {name: value for name, value in vars(self).items() if name not in _IN_BULLET}
        return kept | {"_plane_poses": self._planes.poses}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build a PyBullet world with the same contents, and move its bodies to where they were."""
        plane_poses = state.pop("_plane_poses")
        vars(self).update(state)
        self._build()
        everyone = np.arange(self.count)
        self._weigh(everyone)
        for body, moving in zip(self._vehicles, self._history.states(np.zeros_like(everyone), everyone), strict=True):
            place_body(self._client, body, moving[:3], moving[3:7], moving[7:10], moving[10:])
        self._read()
        self._planes.place(plane_poses, self.position)

    def close(self) -> None:
        """Frees the PyBullet world, as the garbage collector does; a second call does nothing."""
        self._disconnect()
        self._client = -1  # PyBullet gives the number to the next one
