"""One episode in pieces that are short enough for real time: commands act and the LiDAR turns while it flies."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from uavrl.envs.controller import VELOCITY_GAIN
from uavrl.envs.navigation import CONTROL_RATE, PHYSICS_RATE, NavigationEnv
from uavrl.envs.simulation import TRACKING_PERIOD
from uavrl_onboard.geometry import yaw_rotation
from uavrl_onboard.lidar.mount import UPRIGHT, mount_rotation, turned
from uavrl_onboard.lidar.packets import CHANNELS

PIECE = TRACKING_PERIOD / PHYSICS_RATE  # s: 12.5 ms
PIECES = PHYSICS_RATE // CONTROL_RATE // TRACKING_PERIOD  # of a turn of the LiDAR: 8


@dataclass(frozen=True)
class Motion:
    """How a vehicle moves, from its valley's origin: x east, y north, z up."""

    position: np.ndarray  #: ``[3]`` in m
    velocity: np.ndarray  #: ``[3]`` in m/s
    rotation: np.ndarray  #: ``[3, 3]``, from its axes (x forward, y left, z up) to the world's
    rates: np.ndarray  #: ``[3]`` in rad/s, in its axes

    @property
    def yaw(self) -> float:
        """From east to the left, rad in [-π, π]."""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])


class LiveEpisode:
    """One vehicle's episode in the simulator, in pieces of 12.5 ms or in steps of 0.1 s.

    A piece obeys a velocity in the world's axes from its first moment on, and the LiDAR fires the rays of these 12.5 ms
    from where the vehicle is at the piece's end. It makes ten turns in a second, whatever its rate. A step is that of
    the environment: one action, which turns with the vehicle, then a whole scan from where it has led to.

    Args:
        env: the environment, of one vehicle.
        task: its task, which begins.

    Attributes:
        points: ``float32 [R, 3]``, the newest points in the sensor's frame in firing order, NaN for misses.
        last_firing: when the last ray of a turn is fired, in s after its first one.
        outcome: ``success`` or ``collision`` once the episode has ended, else None; time is not kept here.
    """

    def __init__(self, env: NavigationEnv, task: int) -> None:
        if env.num_uavs != 1:
            raise ValueError(f"An episode in real time has one vehicle, got {env.num_uavs}: pass num_uavs=1.")
        self._env, self._state = env, env.reset(task=task)
        mount = env.lidar_sensor.mount
        self._to_sensor = None if mount == UPRIGHT else mount_rotation(mount).T
        self.points: np.ndarray = self._of_sensor(self._state["point_cloud"][0].numpy())
        self.outcome: str | None = None
        self._pieces, self._task = 0, task
        times, sensor = env.lidar_sensor.rays.times, env.lidar_sensor
        group = CHANNELS if sensor.pattern == "vlp16" else 1  # rays that share an azimuth in the sensor's packets
        borders = group * np.searchsorted(times[::group], PIECE * np.arange(PIECES + 1))
        self._borders = [*borders[:-1].tolist(), len(times)]  # of the rays of each piece
        self.last_firing = float(times[-1])
        goal = self._state["goal"][0].double().numpy()
        valley = min(env.world.places, key=lambda each: float(np.hypot(*(each.origin - goal[:2]))))
        self.world_seed = valley.seed
        self._origin = np.append(valley.origin, 0.0)
        self._goal = goal
        self.goal: np.ndarray = goal - self._origin  #: ``[3]`` in m, from the valley's origin

    @property
    def motion(self) -> Motion:
        """Where the vehicle is now, as its estimator believes it: altitude and yaw with their biases."""
        simulation = self._env.simulation
        position = simulation.position[0] - self._origin
        position[2] += simulation.params.altitude_bias[0]
        turned = yaw_rotation(simulation.params.heading_bias[0]) @ simulation.rotation[0]
        return Motion(position, simulation.velocity[0].copy(), turned, simulation.angular_velocity[0].copy())

    @property
    def distance(self) -> float:
        """To the middle of the goal's cylinder, horizontally, m: as an arrival counts, and as ``uavrl-fly`` tells."""
        return math.dist(self._env.simulation.position[0][:2], self._goal[:2])

    def stop_motors(self) -> None:
        """Lets the vehicle fall."""
        self._env.simulation.motors_on = False

    def step(self, command: np.ndarray) -> None:
        """Flies a step of the environment by ``command [4]``."""
        import torch

        action = torch.as_tensor(command, dtype=torch.float32)[None]
        self._state = self._env.step(self._state.set("action", action))["next"]
        self.points = self._of_sensor(self._state["point_cloud"][0].numpy())
        self._conclude(*(bool(self._state[name].any()) for name in ("collided", "arrived")))

    def piece(self, velocity: np.ndarray, yaw_rate: float) -> slice:
        """Flies a piece by a velocity ``[3]`` in the world's axes in m/s and a yaw rate in rad/s.

        Returns:
            The rays of the LiDAR's turn that were cast in it.
        """
        env, simulation = self._env, self._env.simulation
        planes = len(env.traffic.legs)
        path = env.traffic.advance(TRACKING_PERIOD, 1 / PHYSICS_RATE) if planes else None
        command = [*self._along(velocity), velocity[2], yaw_rate]
        collided = simulation.step(np.array([command]), path, TRACKING_PERIOD)
        collided |= env.world.out_of_bounds(simulation.position, env._place_of)
        self._conclude(bool(collided[0]), bool(env.world.arrived(simulation.position, self._goal[None])[0]))
        return self._look()

    def _conclude(self, collided: bool, arrived: bool) -> None:
        """Keeps how the episode has ended, if it has."""
        if self.outcome is None and (collided or arrived):
            self.outcome = "collision" if collided else "success"

    def _along(self, velocity: np.ndarray) -> tuple[float, float]:
        """Which velocity forward and to the left is flown as this one in the world's axes.

        The controller lets a velocity turn with the vehicle, and accelerates sideways for that. One that does not turn
        is that which, so accelerated, comes to it: with gain g and yaw rate r it is v / (1 + i r / g).
        """
        motion = self.motion
        yaw_rate = float(motion.rotation[2] @ motion.rates)
        flat = complex(velocity[0], velocity[1]) * cmath.exp(-1j * motion.yaw)
        flat /= complex(1.0, yaw_rate / VELOCITY_GAIN[0])
        return flat.real, flat.imag

    def _look(self) -> slice:
        """Casts the rays that are fired in a piece, from where it has ended."""
        turn, now = divmod(self._pieces, PIECES)
        self._pieces += 1
        rays = slice(self._borders[now], self._borders[now + 1])
        if now == 0:
            self.points = np.full_like(self.points, np.nan)
        if rays.start < rays.stop:
            self.points[rays] = self._of_sensor(self._env.look(rays, self._task + turn)[0, rays])
        return rays

    def _of_sensor(self, points: np.ndarray) -> np.ndarray:
        """Points ``[P, 3]`` in the axes of the sensor as it is mounted, which are the vehicle's in the simulator."""
        return points if self._to_sensor is None else turned(points, self._to_sensor)
