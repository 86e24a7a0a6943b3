"""The flight controller: velocity command → force → attitude → body rates → moments → rotor thrusts."""

import math

import numpy as np

from uavrl.envs.quadrotor import GRAVITY, ROTOR_SPINS, Aerodynamics, Airframe, drag, mixing_matrix, most_lift

CLIMB_RESERVE = 0.5  # m/s², least acceleration upwards of a vehicle that is not too heavy
VELOCITY_GAIN = np.array([2.6, 2.6, 4.0])  # 1/s, acceleration per velocity error along x, y, z
RATE_GAIN = np.array([24.0, 24.0, 6.0])  # 1/s, angular acceleration per rate error about x, y, z
ATTITUDE_GAIN = 7.0  # 1/s, rate per tilt error
DISTURBANCE_RATE = 2.0  # 1/s, at which the estimate of unknown forces (wind) follows them
DISTURBANCE_LIMIT = np.array([6.0, 6.0, 12.0])  # N, most that it can be along x, y, z: the last also bears weight
_QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # row (x, y) → (-y, x)


def _within(values: np.ndarray, least: np.ndarray | float, most: np.ndarray | float) -> np.ndarray:
    """What `numpy.clip` returns, without its overhead, which outweighs the work on arrays this small."""
    return np.minimum(np.maximum(values, least), most)


def feasible_command(command: np.ndarray, airframe: Airframe, aerodynamics: Aerodynamics) -> np.ndarray:
    """Slows circles that are tighter than the tilt limit allows: commands ``[N, 4]`` in m/s and rad/s.

    A velocity v in the yaw-aligned frame and a yaw rate ψ' make a circle: it takes the acceleration |ψ'| |v| towards
    the centre, and drag takes its share. A vehicle at its tilt limit has g tan(limit), so at 2.83 m/s and 2 rad/s,
    the corner of the action range, it lacks about 6 %. Slowing keeps the direction; saturation would turn it.
    """
    per_mass = aerodynamics.coefficients[0] / airframe.total_mass
    speed = np.sqrt((command[:, :3] ** 2).sum(1))
    horizontal = np.sqrt((command[:, :2] ** 2).sum(1))
    needed = horizontal * np.sqrt(command[:, 3] ** 2 + (per_mass[0] * speed) ** 2)
    available = np.tan(airframe.tilt_limit) * (GRAVITY + per_mass[2] * speed * command[:, 2])
    feasible = command.copy()
    feasible[:, :2] *= np.minimum(1.0, available / np.maximum(needed, 1e-9))[:, None]
    return feasible


def to_world(command: np.ndarray, rotation: np.ndarray, yaw_rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The commanded velocity ``[N, 3]`` in world axes, and the acceleration ``[N, 3]`` that turns it with the yaw.

    Errata: Chansuparp (2022), Eq. 2.1, multiplies 6-vectors element by element and mixes up its angles; what is meant
    is this rotation about the vertical by the yaw ψ. ``command [N, 4]`` holds velocities in the yaw-aligned body frame
    in m/s and a yaw rate; ``rotation [N, 3, 3]`` leads from body to world, ``yaw_rate [N]`` is that of now in rad/s.
    """
    head = rotation[:, :2, 0]
    cos, sin = (head / np.sqrt(np.maximum(np.add.reduce(head * head, axis=1, keepdims=True), 1e-12))).T
    forward, left, up, _ = command.T
    velocity, acceleration = np.empty((len(command), 3)), np.zeros((len(command), 3))
    velocity[:, 0], velocity[:, 1], velocity[:, 2] = cos * forward - sin * left, sin * forward + cos * left, up
    acceleration[:, 0], acceleration[:, 1] = -yaw_rate * velocity[:, 1], yaw_rate * velocity[:, 0]
    return velocity, acceleration


def most_load(airframe: Airframe) -> float:
    """How many times as heavy as believed a vehicle may be, and still be flown: it hovers and can climb.

    Examples:
        >>> round(most_load(Airframe()), 2)
        1.26
    """
    return most_lift(airframe) / (airframe.total_mass * (GRAVITY + CLIMB_RESERVE))


def limit_force(force: np.ndarray, airframe: Airframe) -> np.ndarray:
    """Keeps forces ``[N, 3]`` (N, world axes) within what the rotors give: first the vertical part, then the tilt."""
    vertical = np.minimum(np.maximum(force[:, 2:], 0.3 * airframe.total_mass * GRAVITY), most_lift(airframe))
    horizontal = force[:, :2]
    size = np.sqrt(np.add.reduce(horizontal * horizontal, axis=1, keepdims=True))
    scale = np.minimum(1.0, math.tan(airframe.tilt_limit) * vertical / np.maximum(size, 1e-9))
    return np.concatenate([scale * horizontal, vertical], axis=1)


def tilt_error(direction: np.ndarray) -> np.ndarray:
    """The turn ``[N, 2]`` about x and y that brings the body's z axis to unit vectors ``[N, 3]`` in body axes.

    It is 2 sin(angle / 2) about the shortest axis and grows up to 180°, so that a vehicle on its back turns over.
    """
    half_cosine = np.sqrt(np.maximum(0.5 + 0.5 * direction[:, 2:], 1e-3))
    return direction[:, :2] @ _QUARTER_TURN / half_cosine


class Mixer:
    """Thrust and moments → thrusts of the four rotors, each within [0, a quarter of the total limit].

    Where not everything fits, roll and pitch come first, then the total thrust, then yaw.
    """

    def __init__(self, airframe: Airframe) -> None:
        self._inverse = np.ascontiguousarray(np.linalg.inv(mixing_matrix(airframe)).T)
        self._yaw_share = abs(self._inverse[3, 0])
        self.most = airframe.max_total_thrust / 4

    def __call__(self, wrench: np.ndarray) -> np.ndarray:
        """Returns thrusts ``[N, 4]`` in N for ``wrench [N, 4]``: total thrust in N, moments in N m."""
        thrusts = wrench @ self._inverse
        over = (np.minimum.reduce(thrusts, axis=1) < 0) | (np.maximum.reduce(thrusts, axis=1) > self.most)
        if np.logical_or.reduce(over):
            np.copyto(thrusts, self._saturated(wrench), where=over[:, None])
        return thrusts

    def _saturated(self, wrench: np.ndarray) -> np.ndarray:
        """Gives up yaw first, then total thrust, then roll and pitch."""
        half = self.most / 2
        tilting = wrench[:, 1:3] @ self._inverse[1:3]
        widest = np.maximum.reduce(np.abs(tilting), axis=1, keepdims=True)
        tilting *= half / np.maximum(widest, half)
        widest = np.minimum(widest, half)
        thrusts = tilting + _within(wrench[:, :1] / 4, widest, self.most - widest)
        used = ROTOR_SPINS * (thrusts - half)  # of the room on the side to which a positive yaw moment pushes
        lowest = -half - np.minimum.reduce(used, axis=1, keepdims=True)
        highest = half - np.maximum.reduce(used, axis=1, keepdims=True)
        yawing = _within(wrench[:, 3:] * self._yaw_share, lowest, highest)
        return _within(thrusts + yawing * ROTOR_SPINS, 0.0, self.most)


class VelocityController:
    """Cascaded controller of N quadrotors: the usual ``cmd_vel`` meaning of an action.

    :meth:`track`, the outer loop, turns velocity errors into a force, with feed-forward of drag, of the turn and of
    an estimate of the wind's force. :meth:`thrusts`, the inner loop, turns the body's z axis towards that force, rate
    errors into moments, and thrust and moments into rotor thrusts. The drag that it expects is that of still air.

    Attributes:
        disturbance: ``[N, 3]``, estimate of the unknown forces in world axes in N.
    """

    def __init__(self, count: int, airframe: Airframe, aerodynamics: Aerodynamics) -> None:
        self.airframe = airframe
        self.disturbance = np.zeros((count, 3))
        self._velocity_tm1 = np.zeros((count, 3))
        self._mixer = Mixer(airframe)
        self._coefficients = aerodynamics.coefficients
        self._velocity_gain = airframe.total_mass * VELOCITY_GAIN
        self._rate_gain = np.array(airframe.combined_inertia) * RATE_GAIN
        self._weight = np.array([0.0, 0.0, airframe.total_mass * GRAVITY])
        self._wrench = np.zeros((count, 4))
        self._rates = np.zeros((count, 3))

    def reset(self, index: np.ndarray, hover_force: np.ndarray | float = 0.0) -> None:
        """Forgets the past of the vehicles in ``index``, but for the vertical force ``[M]`` in N that hovering showed.

        They are at rest. A vehicle that hovers carries its weight, whatever its controller believes that to be.
        """
        self.disturbance[index] = 0.0
        self.disturbance[index, 2] = hover_force
        self._velocity_tm1[index] = 0.0

    def track(
        self,
        command: np.ndarray,
        rotation: np.ndarray,
        velocity: np.ndarray,
        twist: np.ndarray,
        lift: np.ndarray,
        dt: float,
    ) -> None:
        """Outer loop: chooses the force for the inner loop, ``dt`` s after the last call.

        ``command`` and ``rotation`` are those of :func:`to_world`. ``velocity [N, 3]`` is that of the centre of mass in
        world axes in m/s, ``twist [N, 2, 3]`` the same in body axes beside the body rates in rad/s, and ``lift [N]``
        the thrust of all rotors now in N.
        """
        resistance = drag(twist, self._coefficients)
        drag_world = np.matmul(rotation, resistance[:, 0, :, None])[:, :, 0]
        self._estimate(velocity, drag_world - self._weight + lift[:, None] * rotation[:, :, 2], dt)
        yaw_rate = np.add.reduce(twist[:, 1] * rotation[:, 2], axis=1)
        target, turning = to_world(command, rotation, yaw_rate)
        force = self._velocity_gain * (target - velocity) + self.airframe.total_mass * turning + self._weight
        self._force = limit_force(force - drag_world - self.disturbance, self.airframe)
        self._direction = self._force / np.sqrt(np.add.reduce(self._force * self._force, axis=1, keepdims=True))
        self._yaw_rate = command[:, 3:]
        self._moment = -resistance[:, 1]  # feed-forward of the rotational drag

    def thrusts(self, rotation: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Inner loop: the rotor thrusts ``[N, 4]`` in N to aim at, from the state as in :meth:`track`."""
        rates, wrench = self._rates, self._wrench
        np.multiply(self._yaw_rate, rotation[:, 2], out=rates)
        rates[:, :2] += ATTITUDE_GAIN * tilt_error(np.matmul(self._direction[:, None], rotation)[:, 0])
        wrench[:, 0] = np.add.reduce(self._force * rotation[:, :, 2], axis=1)
        wrench[:, 1:] = self._rate_gain * (rates - twist[:, 1]) + self._moment
        return self._mixer(wrench)

    def _estimate(self, velocity: np.ndarray, known: np.ndarray, dt: float) -> None:
        """Lets the estimate follow what the known forces ``[N, 3]`` leave unexplained of the acceleration."""
        unknown = (self.airframe.total_mass / dt) * (velocity - self._velocity_tm1) - known
        unknown = _within(unknown, -DISTURBANCE_LIMIT, DISTURBANCE_LIMIT)
        self.disturbance += -np.expm1(-DISTURBANCE_RATE * dt) * (unknown - self.disturbance)
        self._velocity_tm1 = velocity.copy()
