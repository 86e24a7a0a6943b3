"""Vehicles that differ from what their controller believes, drawn anew for each episode (domain randomisation).

Sources: Tobin, Fong, Ray, Schneider, Zaremba and Abbeel (2017), "Domain randomization for transferring deep neural
networks from simulation to the real world"; Peng, Andrychowicz, Zaremba and Abbeel (2018), "Sim-to-real transfer of
robotic control with dynamics randomization", for masses, gains, delays and noise. The ranges are this library's choice.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from uavrl.envs.vehicle_params import VehicleParams
from uavrl.errors import UavrlError

Range = tuple[float, float]
# The least and the most that each range may hold, in the units of Randomization.
LIMITS: dict[str, Range] = {
    "mass": (0.1, 10.0),
    "inertia": (0.1, 10.0),
    "thrust": (0.1, 10.0),
    "motor_time_constant": (0.01, 100.0),
    "drag": (0.0, 100.0),
    "wind": (0.0, 30.0),
    "gust_intensity": (0.0, 30.0),
    "action_delay": (0.0, 0.1),  # one control period
    "scan_delay": (0.0, 0.1),
    "mount_yaw": (-math.pi, math.pi),
    "mount_tilt": (-math.pi, math.pi),
    "range_noise": (0.0, 100.0),
    "dropout": (0.0, 0.999),
    "blind_sector": (0.0, 2 * math.pi),
    "altitude_bias": (-10.0, 10.0),
    "heading_bias": (-math.pi, math.pi),
}
LEAST_LOAD = 0.5  # mass over thrust, as factors: what is lighter rises faster than the controller can learn
_DIRECTIONS = ("wind", "tilt", "blind")  # which are uniform over the circle
_SHARES = {name: place for place, name in enumerate((*LIMITS, *(f"{name}_direction" for name in _DIRECTIONS)))}


@dataclass
class Randomization:
    """What is drawn for each episode: uniformly from ``(low, high)``, or nothing where it is None.

    Factors multiply what `Airframe` and `Aerodynamics` say, the wind comes on top of theirs, and gusts, range noise and
    dropout take the place of those of `Aerodynamics` and `LidarConfig`. The controller goes by the airframe as it
    stands there. Directions are uniform over the circle.

    Args:
        mass: Factor on the total mass; no more than the rotors carry.
        inertia: Factor on the moments of inertia.
        thrust: Factor on the thrust coefficient of all rotors, and so on the greatest thrust.
        motor_time_constant: Factor on the motors' time constant.
        drag: Factor on the drag force's coefficients. The moment's stay: the controller feeds them forward, and
            vehicles with half of them and slow motors tumble.
        wind: Speed of a steady, horizontal wind in m/s.
        gust_intensity: Standard deviation of the gusts along each axis in m/s.
        action_delay: Time in s for which the previous action goes on to act; zeros before the first. It is rounded to
            the controller's outer loop, 1/80 s.
        scan_delay: Age of the scan in s, as are the planes in it; rounded to the physics step, 1/240 s.
        mount_yaw: Turn of the LiDAR's mount about the body's z axis in rad.
        mount_tilt: Tilt of the mount in rad, about a horizontal axis.
        range_noise: Standard deviation of the LiDAR's range error in m.
        dropout: Probability that a hit is not reported.
        blind_sector: Width in rad of the sector about the LiDAR in which it reports nothing.
        altitude_bias: Error in m of the altitude that the policy reads.
        heading_bias: Error in rad of the vehicle's yaw, from which the policy reads its angle to the goal.

    Examples:
        >>> Randomization(mass=(0.8, 1.2)).is_on, Randomization().is_on
        (True, False)
    """

    mass: Range | None = None
    inertia: Range | None = None
    thrust: Range | None = None
    motor_time_constant: Range | None = None
    drag: Range | None = None
    wind: Range | None = None
    gust_intensity: Range | None = None
    action_delay: Range | None = None
    scan_delay: Range | None = None
    mount_yaw: Range | None = None
    mount_tilt: Range | None = None
    range_noise: Range | None = None
    dropout: Range | None = None
    blind_sector: Range | None = None
    altitude_bias: Range | None = None
    heading_bias: Range | None = None

    def __post_init__(self) -> None:
        """Refuses what is no range, or one that holds values that make no vehicle."""
        for name, (least, most) in LIMITS.items():
            if (given := getattr(self, name)) is None:
                continue
            try:
                low, high = given
                fits = bool(least <= low <= high <= most)
            except (TypeError, ValueError):  # not two, or not numbers
                fits = False
            if not fits:
                raise UavrlError(
                    f"{name} must be two numbers in [{least:.4g}, {most:.4g}], the lower one first, or null for off, "
                    f"got {list(given) if np.iterable(given) else given}."
                )
            setattr(self, name, (float(low), float(high)))

    @property
    def is_on(self) -> bool:
        """Whether anything is drawn."""
        return any(getattr(self, field.name) is not None for field in fields(self))


def require_flyable(randomization: Randomization, most_load: float) -> None:
    """Refuses ranges with vehicles that sink or rise whatever is commanded.

    Where the mass is drawn, the heaviest are made lighter (:func:`draw_vehicle`): its lower end must do.
    """
    (lightest, _), (weakest, strongest) = randomization.mass or (1.0, 1.0), randomization.thrust or (1.0, 1.0)
    if lightest > most_load * weakest or lightest < LEAST_LOAD * strongest:
        raise UavrlError(
            f"randomize.mass and randomize.thrust must leave vehicles that can be flown: the least mass at most "
            f"{most_load:.3g} times the least thrust, and at least {LEAST_LOAD} times the greatest (null counts as 1), "
            f"got {lightest:g} with thrusts of {weakest:g} to {strongest:g}."
        )


def draw_vehicle(randomization: Randomization, rng: np.random.Generator, most_load: float = math.inf) -> VehicleParams:
    """Draws one vehicle. A quantity that is switched off leaves the draws of all others as they are.

    A mass of more than ``most_load`` times the thrust, both as factors, is lowered to that, so that every task can be
    flown (:func:`uavrl.envs.controller.most_load`). With 20 % of mass and 15 % of thrust it is one vehicle in twenty.

    Examples:
        >>> drawn = draw_vehicle(Randomization(mass=(0.8, 1.2)), np.random.default_rng(0))
        >>> round(drawn.mass, 3), drawn.thrust
        (1.055, 1.0)
    """
    shares = rng.random(len(_SHARES))
    found = {}
    for name in LIMITS:
        if (within := getattr(randomization, name)) is not None:
            found[name] = float(within[0] + shares[_SHARES[name]] * (within[1] - within[0]))
    if "mass" in found:
        found["mass"] = min(found["mass"], most_load * found.get("thrust", 1.0))
    wind, tilt, blind = (2 * math.pi * float(shares[_SHARES[f"{name}_direction"]]) for name in _DIRECTIONS)
    speed = found.pop("wind", 0.0)
    along = (speed * math.cos(wind), speed * math.sin(wind))
    return VehicleParams(**found, wind=along, mount_axis=tilt, blind_azimuth=blind)


def draw_vehicles(
    randomization: Randomization, seed: int, tasks: Iterable[int], most_load: float
) -> list[VehicleParams]:
    """The vehicles of tasks: each depends on the seed and its task alone, by a stream beside that of start and goal."""
    return [draw_vehicle(randomization, np.random.default_rng((seed, task, 1)), most_load) for task in tasks]
