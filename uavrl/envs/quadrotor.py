"""The quadrotor as a rigid body: masses, rotors and aerodynamic drag, in pure numpy over N vehicles.

Source: Chansuparp (2022), §2.1, Eq. 2.1 to 2.5, with the parameters of hector_quadrotor, the simulator model it flew:
Meyer, Sendobry, Kohlbrecher, Klingauf and von Stryk (2012), "Comprehensive Simulation of Quadrotor UAVs Using ROS and
Gazebo". Axes are x forward, y left, z up. Gravity and rigid-body motion (Eq. 2.3 and 2.4) are the physics engine's.
"""

import math
from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from pydantic import Field

from uavrl.envs.limits import require_finite
from uavrl.errors import UavrlError
from uavrl_onboard.ranges import Positive, Rule
from uavrl_onboard.vehicle import ARM, LIDAR_DIAMETER, LIDAR_HEIGHT, ROTOR_DIRECTIONS, VEHICLE, Vehicle

GRAVITY = 9.81  # m/s²
THRUST_RESERVE = 0.1  # share of the rotors' thrust that climbing leaves to roll, pitch and yaw
Vector = tuple[float, float, float]
Mass = Annotated[float, Field(le=1e4)]
Offset = Annotated[float, Field(ge=-10, le=10)]
Length = Annotated[float, Field(gt=0, le=10)]
Coefficient = Annotated[float, Field(le=1e3)]
Speed = Annotated[float, Field(ge=-100, le=100)]
Tilt = Annotated[float, Rule("an angle in (0, π/2) rad", lambda angle: 0 < angle < math.pi / 2)]

# Sign of the yaw moment that each rotor leaves on the body; neighbours turn against each other.
ROTOR_SPINS = np.array([-1.0, 1.0, -1.0, 1.0])


def _require_three(config: object, names: tuple[str, ...]) -> None:
    """Refuses vectors of another length."""
    for name in names:
        value = getattr(config, name)
        if np.shape(value) != (3,):
            got = list(value) if np.iterable(value) else value
            raise UavrlError(f"{name} takes three numbers, one for each axis, got {got}.")


@dataclass
class Airframe:
    """hector_quadrotor with a Velodyne VLP-16 on top.

    Sources: Chansuparp (2022), §2.1 and §3.1; Meyer et al. (2012) for masses, arm and rotors (``CT0s``, ``k_t``). Their
    motor model, linearised at hover, has the time constant 0.047 s; ours is a first-order lag of the rotor speed.

    Args:
        mass: Mass without the LiDAR in kg.
        inertia: Its principal moments of inertia about its own centre in kg m².
        arm: Distance from the centre to each rotor's axis in m.
        thrust_coefficient: Thrust per squared rotor speed in N s²/rad².
        torque_to_thrust: Drag torque per thrust of a rotor in m.
        motor_time_constant: First-order lag of the rotor speed in s.
        max_total_thrust: Most that all four rotors give together in N.
        tilt_limit: Greatest tilt that the controller asks for in rad.
        collision_radius: Radius of the collision cylinder in m.
        collision_height: Height of the collision cylinder, centred in the airframe, in m.
        lidar_mass: Mass of the LiDAR in kg.
        lidar_position: Its centre in body axes in m; on the z axis.
        lidar_diameter: Diameter of its cylindrical housing in m.
        lidar_height: Height of its housing in m.

    Examples:
        >>> airframe = Airframe()
        >>> round(airframe.total_mass, 3), [round(x, 4) for x in airframe.centre_of_mass]
        (2.307, [0.0, 0.0, 0.036])
    """

    mass: Mass = 1.477
    inertia: tuple[Mass, Mass, Mass] = (0.01152, 0.01152, 0.0218)
    arm: Annotated[float, Field(le=10)] = ARM
    thrust_coefficient: Annotated[float, Field(le=1)] = 1.53819e-5
    torque_to_thrust: Length = 0.01534
    motor_time_constant: Annotated[float, Field(le=100)] = 0.05
    max_total_thrust: Annotated[float, Field(le=1e6)] = 38.0
    tilt_limit: Tilt = 0.5
    collision_radius: Positive = VEHICLE.radius
    collision_height: Positive = VEHICLE.height
    lidar_mass: Mass = 0.83
    lidar_position: tuple[Offset, Offset, Offset] = VEHICLE.lidar_position
    lidar_diameter: Length = LIDAR_DIAMETER
    lidar_height: Length = LIDAR_HEIGHT

    def __post_init__(self) -> None:
        """Refuses vehicles that cannot fly."""
        _require_three(self, ("inertia", "lidar_position"))
        require_finite(self, [field.name for field in fields(self)])
        if self.lidar_position[0] or self.lidar_position[1]:
            raise ValueError(
                f"The LiDAR must sit on the body's z axis, got {self.lidar_position}; pass (0, 0, height) in metres."
            )
        if min(self.mass, *self.inertia, self.arm, self.thrust_coefficient, self.motor_time_constant) <= 0:
            raise ValueError(
                f"Mass, inertia, arm, thrust coefficient and motor time constant of an airframe must be above 0, got "
                f"{self.mass}, {self.inertia}, {self.arm}, {self.thrust_coefficient} and {self.motor_time_constant}."
            )
        if self.lidar_mass < 0:
            raise ValueError(f"lidar_mass must not be negative, got {self.lidar_mass} kg.")
        if not 0 < self.tilt_limit < math.pi / 2:
            raise UavrlError(f"tilt_limit must be an angle in (0, π/2) rad, got {self.tilt_limit}.")
        _require_hovering(self)

    @property
    def total_mass(self) -> float:
        """Mass with the LiDAR in kg."""
        return self.mass + self.lidar_mass

    def vehicle(self, flight_level: float = VEHICLE.flight_level, max_speed: float = VEHICLE.velocity_limit) -> Vehicle:
        """Return the vehicle that guards and planners assume, around a flight level in m, with its limit in m/s."""
        return Vehicle(
            radius=self.collision_radius,
            height=self.collision_height,
            lidar_position=self.lidar_position,
            velocity_limit=max_speed,
            yaw_rate_limit=min(max_speed, VEHICLE.yaw_rate_limit),  # as the environment's actions have it
            flight_level=flight_level,
        )

    @property
    def centre_of_mass(self) -> Vector:
        """Common centre of mass ``(x, y, z)`` in body axes, from the airframe's geometric centre, in m."""
        x, y, z = (self.lidar_mass / self.total_mass * p for p in self.lidar_position)
        return x, y, z

    @property
    def combined_inertia(self) -> Vector:
        """Moments of inertia ``(xx, yy, zz)`` of airframe and LiDAR about their common centre of mass in kg m².

        The LiDAR counts as a solid cylinder; the parallel-axis theorem brings both bodies to the common centre.
        """
        radius, height = self.lidar_diameter / 2, self.lidar_height
        across = self.lidar_mass * (3 * radius**2 + height**2) / 12
        along = self.lidar_mass * radius**2 / 2
        apart = self.mass * self.lidar_mass / self.total_mass * self.lidar_position[2] ** 2
        return self.inertia[0] + across + apart, self.inertia[1] + across + apart, self.inertia[2] + along

    @property
    def hover_speed(self) -> float:
        """Rotor speed in rad/s at which four rotors carry the weight."""
        return float(np.sqrt(self.total_mass * GRAVITY / 4 / self.thrust_coefficient))


def most_lift(airframe: Airframe) -> float:
    """The greatest vertical force in N that the controller asks of the rotors.

    It keeps a tenth of the thrust for roll, pitch and yaw, and holds the height at the greatest tilt, too.

    Examples:
        >>> round(most_lift(Airframe()), 2)
        30.01
    """
    return (1 - THRUST_RESERVE) * airframe.max_total_thrust * math.cos(airframe.tilt_limit)


def _require_hovering(airframe: Airframe) -> None:
    """Refuse an airframe that sinks whatever is commanded."""
    lift, weight = most_lift(airframe), airframe.total_mass * GRAVITY
    if weight <= lift:
        return
    heaviest = math.floor(1000 * (lift / GRAVITY - airframe.lidar_mass)) / 1000
    needed = math.ceil(10 * airframe.max_total_thrust * weight / lift) / 10 if lift > 0 else None
    ways = [f"lower mass to at most {heaviest:g} kg"] if heaviest > 0 else []
    ways += [f"raise max_total_thrust to at least {needed:g} N"] if needed else ["give a max_total_thrust above 0"]
    raise UavrlError(
        f"An airframe of {airframe.total_mass:.6g} kg must lift its weight of {weight:.1f} N to hover, but its rotors "
        f"lift at most {lift:.1f} N: the controller keeps a tenth of max_total_thrust for turning, and tilts by up to "
        f"{airframe.tilt_limit:g} rad. To make it hover, {' or '.join(ways)}."
    )


@dataclass
class Aerodynamics:
    """Drag, wind and gusts: Chansuparp (2022), Eq. 2.5, reduced to its diagonal terms.

    Force and moment are quadratic: ``F_i = -(ρ/2) c_i |v| v_i`` with the air-relative velocity v in body axes, and
    ``M_i = -(ρ/2) d_i |ω| ω_i`` with the body rates ω, both at the centre of mass.

    Errata: the text takes the angles of attack in Eq. 2.5 from moments of inertia (I_z / I_x); it means velocities.
    With one coefficient per axis they cancel out: ``|v| v_i`` is ``|v|²`` times their sines and cosines.

    The defaults are those of Meyer et al. (2012): (ρ/2) c = (0.12, 0.12, 0.1) N s²/m² and
    (ρ/2) d = (0.0742, 0.0742, 0.0506) N m s².

    Args:
        air_density: ρ in kg/m³.
        force_coefficients: c along the body axes in m².
        moment_coefficients: d about the body axes in m⁵.
        wind: Constant wind along the world axes in m/s.
        gust_intensity: Standard deviation of the gusts along each world axis in m/s; 0 turns them off.
        gust_time_constant: Correlation time of the gusts in s.

    Examples:
        >>> Aerodynamics().coefficients.round(3).tolist()
        [[0.12, 0.12, 0.1], [0.074, 0.074, 0.051]]
    """

    air_density: Coefficient = 1.225
    force_coefficients: tuple[Coefficient, Coefficient, Coefficient] = (0.19592, 0.19592, 0.16327)
    moment_coefficients: tuple[Coefficient, Coefficient, Coefficient] = (0.12107, 0.12107, 0.08268)
    wind: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    gust_intensity: Annotated[float, Field(le=100)] = 0.0
    gust_time_constant: Annotated[float, Field(le=1e6)] = 1.0

    def __post_init__(self) -> None:
        """Refuses air that would push instead of drag."""
        _require_three(self, ("force_coefficients", "moment_coefficients", "wind"))
        require_finite(self, [field.name for field in fields(self)])
        if min(self.air_density, *self.force_coefficients, *self.moment_coefficients, self.gust_intensity) < 0:
            raise ValueError(
                f"Air density, drag coefficients and gust intensity must not be negative, got {self.air_density}, "
                f"{self.force_coefficients}, {self.moment_coefficients} and {self.gust_intensity}."
            )
        if self.gust_time_constant <= 0:
            raise ValueError(f"gust_time_constant must be above 0 s, got {self.gust_time_constant}.")

    @property
    def coefficients(self) -> np.ndarray:
        """``[2, 3]``: drag per squared velocity in N s²/m², and drag moment per squared rate in N m s²."""
        return self.air_density / 2 * np.array([self.force_coefficients, self.moment_coefficients])


def mixing_matrix(airframe: Airframe) -> np.ndarray:
    """``[4, 4]``: (total thrust in N, moments about x, y, z in N m) = matrix @ the rotors' thrusts in N."""
    x, y = airframe.arm * ROTOR_DIRECTIONS.T
    return np.stack([np.ones(4), y, -x, airframe.torque_to_thrust * ROTOR_SPINS])


def drag(twist: np.ndarray, coefficients: np.ndarray, limit: np.ndarray | float = np.inf) -> np.ndarray:
    """Quadratic drag force and moment: Chansuparp (2022), Eq. 2.5, diagonal.

    Args:
        twist: ``[N, 2, 3]``: air-relative velocity in m/s and rates in rad/s, in body axes.
        coefficients: ``[2, 3]`` or ``[N, 2, 3]``, see :attr:`Aerodynamics.coefficients`.
        limit: likewise, the most drag per velocity in N s/m and N m s. Mass and inertia over the time step keep an
            explicit integration stable: drag then stops a motion, at most, and never turns it round.

    Returns:
        ``[N, 2, 3]``: force in N and moment in N m, in body axes.
    """
    magnitude = np.sqrt(np.add.reduce(twist * twist, axis=2, keepdims=True))
    return -np.minimum(coefficients * magnitude, limit) * twist


def gust_path(
    gust: np.ndarray,
    intensity: float | np.ndarray,
    time_constant: float,
    dt: float,
    steps: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Gusts ``[T, N, 3]`` in m/s after T time steps: first-order noise (Ornstein-Uhlenbeck), exact for any ``dt``.

    It is the simplest of Dryden's spectra. ``gust [N, 3]`` is that of now; ``intensity`` is its stationary standard
    deviation in m/s, one or ``[N, 1]``; ``time_constant`` is its correlation time in s, and ``dt`` the time step in s.
    """
    kept = np.exp(-dt / time_constant)
    path = intensity * np.sqrt(1 - kept**2) * rng.standard_normal((steps, *gust.shape))
    for step in range(steps):
        path[step] += kept * (path[step - 1] if step else gust)
    return path
