"""Parameters of the simulated vehicles, which differ from what their controller assumes: one, and N as arrays."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from uavrl.envs.quadrotor import GRAVITY, Aerodynamics, Airframe
from uavrl_onboard.geometry import heading_vector, rotation_about, yaw_rotation


@dataclass(frozen=True)
class VehicleParams:
    """Parameters of one vehicle, those of :class:`uavrl.envs.Randomization`; by default what the controller assumes.

    ``wind`` is along world x and y; ``mount_axis`` and ``blind_azimuth`` are angles in rad about the z axis, from x to
    the left. ``None`` leaves gusts, range noise and dropout to `Aerodynamics` and `LidarConfig`.
    """

    mass: float = 1.0
    inertia: float = 1.0
    thrust: float = 1.0
    motor_time_constant: float = 1.0
    drag: float = 1.0
    wind: tuple[float, float] = (0.0, 0.0)
    gust_intensity: float | None = None
    action_delay: float = 0.0
    scan_delay: float = 0.0
    mount_yaw: float = 0.0
    mount_tilt: float = 0.0
    mount_axis: float = 0.0
    range_noise: float | None = None
    dropout: float | None = None
    blind_sector: float = 0.0
    blind_azimuth: float = 0.0
    altitude_bias: float = 0.0
    heading_bias: float = 0.0

    @property
    def mount(self) -> np.ndarray:
        """The rotation ``[3, 3]`` from the LiDAR's axes to the body's: first the tilt, then the yaw."""
        axis = np.append(heading_vector(self.mount_axis), 0.0)
        return yaw_rotation(self.mount_yaw) @ rotation_about(axis, self.mount_tilt)


class FleetParams:
    """Parameters of N vehicles, which are as ``airframe`` and ``aerodynamics`` say, until :meth:`put` says otherwise.

    Args:
        count: Number of vehicles N.
        airframe: The vehicle, as its controller believes it to be.
        aerodynamics: Drag, wind and gusts likewise.
        dt: Physics step in s.
        tracking_period: Physics steps per step of the controller's outer loop.

    Attributes:
        each: The parameters of each of the N vehicles.
        mass: ``[N]`` in kg, with the LiDAR.
        inertia: ``[N, 3]`` in kg m², likewise.
        thrust: ``[N, 4]``, factor on the thrust coefficient; None where it is 1.
        motor_gain: ``[N, 4]``, share of the way to the wanted rotor speed in a physics step.
        hover_speed: ``[N, 1]`` in rad/s.
        hover_force: ``[N]`` in N, the vertical force that the controller sees in hovering and cannot explain.
        drag: ``[N, 2, 3]``, see :attr:`Aerodynamics.coefficients`.
        drag_limit: ``[N, 2, 3]``, see :func:`uavrl.envs.quadrotor.drag`.
        wind: ``[N, 3]`` in m/s, world axes.
        gust_intensity: ``[N, 1]`` in m/s.
        gusty: Whether any vehicle meets gusts.
        still_air: Whether there is neither wind nor gust.
        action_delay: ``[N, 1]`` in physics steps, a multiple of the tracking period.
        scan_delay: ``[N]`` in physics steps.
        flawed: Whether any LiDAR has noise, dropout or a blind sector of its own.
        mount: ``[N, 3, 3]``, from the LiDAR's axes to the body's; None where all are straight.
        altitude_bias: ``[N]`` in m.
        heading_bias: ``[N]`` in rad.
    """

    def __init__(
        self, count: int, airframe: Airframe, aerodynamics: Aerodynamics, dt: float, tracking_period: int
    ) -> None:
        self.airframe, self.aerodynamics = airframe, aerodynamics
        self._dt, self._tracking_period = dt, tracking_period
        self.each = [VehicleParams()] * count
        self._derive()

    def put(self, index: Iterable[int], params: Iterable[VehicleParams]) -> None:
        """Makes these of the vehicles in ``index``."""
        for row, one in zip(index, params, strict=True):
            self.each[row] = one
        self._derive()

    def _column(self, name: str) -> np.ndarray:
        return np.array([getattr(one, name) for one in self.each], dtype=np.float64)[:, None]

    def _derive(self) -> None:
        """Computes all arrays."""
        airframe, air = self.airframe, self.aerodynamics
        mass, inertia, thrust = self._column("mass"), self._column("inertia"), self._column("thrust")
        self.mass, self.inertia = airframe.total_mass * mass[:, 0], airframe.combined_inertia * inertia
        self.hover_speed = airframe.hover_speed * np.sqrt(mass / thrust)
        self.hover_force = airframe.total_mass * GRAVITY * (1 - mass / thrust)[:, 0]
        self.thrust = np.tile(thrust, 4) if (thrust != 1).any() else None
        lag = airframe.motor_time_constant * self._column("motor_time_constant")
        self.motor_gain = np.tile(1 - np.exp(-self._dt / lag), 4)
        drag = np.stack([self._column("drag"), np.ones((len(self.each), 1))], axis=1)  # of the force alone
        self.drag = air.coefficients * drag
        self.drag_limit = np.stack([np.tile(self.mass[:, None], 3), self.inertia], axis=1) / self._dt
        self.wind = np.array(air.wind) + [(*one.wind, 0.0) for one in self.each]
        gusts = [air.gust_intensity if one.gust_intensity is None else one.gust_intensity for one in self.each]
        self.gust_intensity = np.array(gusts, dtype=np.float64)[:, None]
        self.gusty = bool(self.gust_intensity.any())
        self.still_air = not (self.gusty or self.wind.any())
        period = self._tracking_period
        self.action_delay = period * np.rint(self._column("action_delay") / (period * self._dt)).astype(np.int64)
        self.scan_delay = np.rint(self._column("scan_delay")[:, 0] / self._dt).astype(np.int64)
        own = [(one.range_noise, one.dropout) for one in self.each]
        self.flawed = any(one.blind_sector for one in self.each) or set(own) != {(None, None)}
        turned = any(one.mount_yaw or one.mount_tilt for one in self.each)
        self.mount = np.stack([one.mount for one in self.each]) if turned else None
        self.altitude_bias, self.heading_bias = self._column("altitude_bias")[:, 0], self._column("heading_bias")[:, 0]
