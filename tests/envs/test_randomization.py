"""Vehicles that differ from what their controller believes, against closed forms."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest

from tests.helpers.vehicles import world
from uavrl.envs.bullet import pybullet
from uavrl.envs.controller import most_load
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.randomization import LIMITS, Randomization, draw_vehicle
from uavrl.envs.simulation import Simulation
from uavrl.envs.vehicle_params import VehicleParams
from uavrl.errors import UavrlError
from uavrl_onboard.lidar.vlp16 import AZIMUTH_STEP, AZIMUTH_STEPS, NUM_RAYS
from uavrl_onboard.mesh import Mesh

NO_DRAG = Aerodynamics(force_coefficients=(0.0, 0.0, 0.0), moment_coefficients=(0.0, 0.0, 0.0))
QUAD = [[0, 1, 2], [0, 2, 3]]
FLOOR = Mesh([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], QUAD)
BOX = Mesh([[-3, -2, 0], [5, -2, 0], [5, 4, 0], [-3, 4, 0], [-3, -2, 9], [5, -2, 9], [5, 4, 9], [-3, 4, 9]],
           [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]])  # fmt: skip
MASS, WEIGHT, THRUST = 2.307, 2.307 * 9.81, 1.53819e-5


def begin(simulation: Simulation, *params: VehicleParams) -> None:
    """Places the vehicles anew, at (0, 0, 3.5) along x, with these parameters."""
    count = simulation.count
    simulation.reset(np.arange(count), np.tile([0.0, 0.0, 3.5], (count, 1)), np.zeros(count), params)


def fly(simulation: Simulation, steps: int, *command: float) -> None:
    for _ in range(steps):
        simulation.step(np.tile(command or np.zeros(4), (simulation.count, 1)))


def test_a_vehicle_hovers_from_the_first_step_at_the_rotor_speed_of_its_own_mass_and_thrust() -> None:
    with world(3) as simulation:
        begin(simulation, VehicleParams(), VehicleParams(mass=1.2, thrust=0.9), VehicleParams(mass=0.8, thrust=1.15))
        factors = np.array([1.0, 1.2 / 0.9, 0.8 / 1.15])
        expected = np.sqrt(factors * WEIGHT / 4 / THRUST)
        np.testing.assert_allclose(simulation.rotor_speed, expected[:, None].repeat(4, 1), rtol=1e-12)
        simulation._controller.thrusts = lambda rotation, twist: THRUST * simulation.rotor_speed**2  # they keep it
        fly(simulation, 10)
        np.testing.assert_allclose(simulation.velocity, np.zeros((3, 3)), atol=1e-6)


def test_the_controller_learns_the_difference_as_a_disturbance() -> None:
    with world(2) as simulation:
        begin(simulation, VehicleParams(mass=1.1), VehicleParams(thrust=1.1))
        fly(simulation, 35)
        np.testing.assert_allclose(simulation.velocity, np.zeros((2, 3)), atol=0.01)
        lift = np.array([[1.0], [1.1]]) * THRUST * simulation.rotor_speed**2
        np.testing.assert_allclose(lift.sum(1), [1.1 * WEIGHT, WEIGHT], rtol=1e-3)
        # What its own rotors and mass leave unexplained: -0.1 m g, and a tenth of its own idea of the thrust.
        expected = [-0.1 * WEIGHT, WEIGHT - WEIGHT / 1.1]
        np.testing.assert_allclose(simulation._controller.disturbance[:, 2], expected, atol=0.05)


def test_acceleration_and_turning_go_by_mass_thrust_and_inertia() -> None:
    plant = VehicleParams(mass=1.3, inertia=0.7, thrust=0.9)
    with world(1, aerodynamics=NO_DRAG, control_rate=240) as simulation:
        begin(simulation, plant)
        simulation._controller.thrusts = lambda rotation, twist: THRUST * simulation.rotor_speed**2
        simulation.rotor_speed = np.array([[700.0, 600.0, 500.0, 600.0]])
        front, left, back, right = 0.9 * THRUST * simulation.rotor_speed[0] ** 2
        fly(simulation, 1)
        moments = np.array([0.0, -0.275 * (front - back), 0.01534 * (left + right - front - back)])
        turning = moments / (0.7 * np.array(Airframe().combined_inertia)) / 240
        np.testing.assert_allclose(simulation.angular_velocity[0], turning, atol=2e-4)
        climb = ((front + left + back + right) / (1.3 * MASS) - 9.81) / 240
        assert simulation.velocity[0, 2] == pytest.approx(climb, abs=2e-4)
        known = pybullet.getDynamicsInfo(simulation._vehicles[0], -1, physicsClientId=simulation._client)
        assert known[0] == pytest.approx(1.3 * MASS)
        begin(simulation, VehicleParams())
        known = pybullet.getDynamicsInfo(simulation._vehicles[0], -1, physicsClientId=simulation._client)
        assert known[0] == pytest.approx(MASS) and known[2] == pytest.approx(Airframe().combined_inertia)


def test_motors_follow_with_their_own_time_constants() -> None:
    with world(2, control_rate=240) as simulation:
        begin(simulation, VehicleParams(motor_time_constant=0.5), VehicleParams(motor_time_constant=2.0))
        simulation._controller.thrusts = lambda rotation, twist: np.full((2, 4), THRUST * 900.0**2)
        first = simulation.rotor_speed.copy()
        fly(simulation, 12)  # 0.05 s
        left = np.exp(-0.05 / np.array([[0.025], [0.1]]))
        np.testing.assert_allclose(simulation.rotor_speed, 900 + (first - 900) * left, rtol=1e-9)


def test_terminal_velocities_go_by_mass_and_drag() -> None:
    with world(2, aerodynamics=Aerodynamics(force_coefficients=(0.2, 0.2, 1.0))) as simulation:
        begin(simulation, VehicleParams(drag=1.5), VehicleParams(mass=1.2, drag=0.5))
        simulation.motors_on = False
        fly(simulation, 80)
        expected = np.sqrt(2 * WEIGHT * np.array([1 / 1.5, 1.2 / 0.5]) / 1.225)
        np.testing.assert_allclose(-simulation.velocity[:, 2], expected, rtol=2e-3)


def test_the_drag_moment_stays_as_the_controller_believes_it() -> None:
    with world(2) as simulation:
        begin(simulation, VehicleParams(drag=0.5), VehicleParams(drag=1.5))
        force, moment = Aerodynamics().coefficients
        np.testing.assert_allclose(simulation.params.drag, [[0.5 * force, moment], [1.5 * force, moment]])


def test_a_steady_wind_is_leant_against() -> None:
    with world(2, aerodynamics=Aerodynamics(wind=(0.0, 1.0, 0.0))) as simulation:
        begin(simulation, VehicleParams(wind=(2.0, 0.0)), VehicleParams())
        fly(simulation, 45)
        np.testing.assert_allclose(simulation.velocity, np.zeros((2, 3)), atol=5e-3)
        for row, wind in enumerate([(2.0, 1.0), (0.0, 1.0)]):  # on top of that of the air
            push = 0.12 * np.hypot(*wind) * np.array(wind)  # (ρ/2) c |v| v
            up = simulation.rotation[row, :, 2]
            np.testing.assert_allclose(up[:2] / up[2], -push / WEIGHT, atol=2e-4)


def test_gusts_have_the_intensity_of_each_vehicle() -> None:
    air = Aerodynamics(gust_intensity=2.0, gust_time_constant=0.02)
    with world(3, aerodynamics=air, rng=np.random.default_rng(0)) as simulation:
        begin(simulation, VehicleParams(gust_intensity=0.0), VehicleParams(gust_intensity=0.5), VehicleParams())
        met = []
        for _ in range(60):
            fly(simulation, 1)
            met.append(simulation._gust)
        np.testing.assert_allclose(np.std(met, axis=(0, 2)), [0.0, 0.5, 2.0], rtol=0.2)
    with world() as simulation, pytest.raises(ValueError, match="Gusts need"):
        begin(simulation, VehicleParams(gust_intensity=0.5))


def places(simulation: Simulation, commands: list[tuple[float, ...]]) -> np.ndarray:
    """Where the vehicles are after each physics step, ``[T, N, 3]``."""
    seen = []
    for command in commands:
        fly(simulation, 1, *command)
        seen += [state[:, :3] for state in simulation._history._states[1:]]
    return np.array(seen)


def test_an_action_that_comes_late_flies_the_same_path_later() -> None:
    """From rest, which lasts, each command begins and ends d later."""
    delays = [0, 3, 12, 24]  # physics steps
    with world(len(delays)) as simulation:
        begin(simulation, *(VehicleParams(action_delay=delay / 240) for delay in delays))
        path = places(
            simulation, [(1.0, 0.0, 0.5, 0.0), (-1.0, 2.0, 0.0, 1.0), (0.0, 0.0, 0.0, -2.0), (2.0, 1.0, 0.0, 0.0)]
        )
        for row, delay in enumerate(delays):
            np.testing.assert_allclose(path[delay:, row], path[: len(path) - delay, 0], atol=1e-6)
        assert np.abs(path[:, 0] - path[:, -1]).max() > 0.02
        begin(simulation, *simulation.params.each)  # the last command of one episode is not the first of the next
        fly(simulation, 1)
        np.testing.assert_allclose(simulation.velocity, np.zeros((4, 3)), atol=1e-6)


@pytest.mark.parametrize("distorted", [False, True])
def test_a_scan_that_is_late_shows_what_was_seen_then(distorted: bool) -> None:
    sail = Mesh([[0, -1, -1], [0, 1, -1], [0, 0, 1]], [[0, 1, 2]])
    lidar, rng = Lidar([BOX], sail, LidarConfig(motion_distortion=distorted)), np.random.default_rng(0)
    planes = np.array([[2.0, 0.0, 3.5, 1.0]])
    path = planes + np.arange(25)[:, None, None] * [0.02, 0.0, 0.0, 0.0]
    with world(3, plane_mesh=sail, plane_count=1) as simulation, world(1) as alone:
        begin(simulation, *(VehicleParams(scan_delay=delay / 240) for delay in (0, 5, 24)))
        begin(alone, VehicleParams())
        simulation.place_planes(planes)
        first = simulation.scan(lidar, np.arange(3), planes, rng)
        for row in range(3):  # there was nothing before
            np.testing.assert_array_equal(first[row], alone.scan(lidar, np.array([0]), planes, rng)[0])
        fly(simulation, 1, 2.0, 1.0, 0.0, 2.0)
        simulation.step(np.tile([2.0, 1.0, 0.0, 2.0], (3, 1)), path[1:])
        late = simulation.scan(lidar, np.array([2, 1, 0]), path[-1], rng)
        for cloud, delay in zip(late, [24, 5, 0], strict=True):
            alone_at(alone, simulation._history._states[-1 - delay][0])
            expected = alone.scan(lidar, np.array([0]), path[-1 - delay], rng)[0]
            np.testing.assert_allclose(cloud, expected, atol=2e-3)


def alone_at(simulation: Simulation, state: np.ndarray) -> None:
    """Puts the only vehicle where a state says, as it moves there."""
    body, at = simulation._vehicles[0], {"physicsClientId": simulation._client}
    pybullet.resetBasePositionAndOrientation(body, state[:3], state[3:7], **at)
    pybullet.resetBaseVelocity(body, state[7:10], state[10:], **at)
    simulation._read()
    simulation._publish()


def scan(*params: VehicleParams, config: LidarConfig | None = None) -> np.ndarray:
    with world(len(params)) as simulation:
        begin(simulation, *params)
        lidar = Lidar([BOX, FLOOR], config=config)
        return simulation.scan(lidar, np.arange(len(params)), None, np.random.default_rng(0))


def test_a_turned_mount_turns_the_cloud() -> None:
    turned, straight = np.linalg.norm(
        scan(VehicleParams(mount_yaw=10 * AZIMUTH_STEP), VehicleParams()), axis=-1
    ).reshape(2, AZIMUTH_STEPS, 16)
    np.testing.assert_allclose(turned[10:], straight[:-10], rtol=1e-4)  # the sensor turns clockwise
    assert np.abs(turned - straight).max() > 0.1


def test_a_tilted_mount_looks_down_on_one_side() -> None:
    """Nose down by θ: the laser at elevation e straight ahead meets the ground at h / sin(θ - e)."""
    tilt, height = 0.05, 3.6
    with world(1) as simulation:
        begin(simulation, VehicleParams(mount_tilt=tilt, mount_axis=np.pi / 2))
        cloud = simulation.scan(Lidar([FLOOR]), np.array([0]), None, np.random.default_rng(0))[0, :16]
    elevation = np.radians([-15, -13, -11, -9, -7, -5])
    lasers = [0, 2, 4, 6, 8, 10]
    np.testing.assert_allclose(np.linalg.norm(cloud[lasers], axis=-1), height / np.sin(tilt - elevation), rtol=1e-4)
    direction = np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], -1)
    np.testing.assert_allclose(
        cloud[lasers] / np.linalg.norm(cloud[lasers], axis=-1, keepdims=True), direction, atol=3e-3
    )


@pytest.mark.parametrize(("azimuth", "width"), [(0.0, 0.5), (2.0, 1.0), (-3.1, 1.0), (6.0, 2 * math.pi), (1.0, 0.0)])
def test_nothing_returns_from_the_blind_sector(azimuth: float, width: float) -> None:
    blind, seen = scan(VehicleParams(blind_azimuth=azimuth, blind_sector=width), VehicleParams())
    directions = Lidar([]).directions
    off = np.abs((np.arctan2(directions[:, 1], directions[:, 0]) - azimuth + np.pi) % (2 * np.pi) - np.pi)
    hidden = np.isnan(blind[:, 0])
    inside, outside = off < width / 2 - AZIMUTH_STEP, off > width / 2 + AZIMUTH_STEP
    assert hidden[inside].all() and hidden.mean() == pytest.approx(width / (2 * math.pi), abs=0.002)
    np.testing.assert_array_equal(blind[outside], seen[outside])


def test_noise_and_dropout_are_those_of_each_vehicle() -> None:
    exact = np.linalg.norm(scan(VehicleParams())[0], axis=-1)
    config = LidarConfig(range_noise=0.05, dropout=0.3)
    noisy = scan(
        VehicleParams(range_noise=0.0, dropout=0.0),
        VehicleParams(range_noise=0.02, dropout=0.1),
        VehicleParams(),
        config=config,
    )
    error = np.linalg.norm(noisy, axis=-1) - exact
    np.testing.assert_allclose(np.nanstd(error, axis=1), [0.0, 0.02, 0.05], rtol=0.03, atol=1e-6)
    hits = (~np.isnan(exact)).sum()
    np.testing.assert_allclose(1 - (~np.isnan(error)).sum(1) / hits, [0.0, 0.1, 0.3], atol=0.01)


ALL = Randomization(
    mass=(0.8, 1.2), inertia=(0.7, 1.2), thrust=(0.85, 1.15), motor_time_constant=(0.5, 2.0), drag=(0.5, 1.5),
    wind=(0.5, 2.0), gust_intensity=(0.1, 0.5), action_delay=(0.0, 0.1), scan_delay=(0.02, 0.1),
    mount_yaw=(-0.05, 0.05), mount_tilt=(-0.04, 0.05), range_noise=(0.0, 0.03), dropout=(0.0, 0.1),
    blind_sector=(0.0, 1.0), altitude_bias=(-0.2, 0.2), heading_bias=(-0.08, 0.09),
)  # fmt: skip


def test_each_quantity_is_uniform_in_its_range_and_independent_of_the_others() -> None:
    rng = np.random.default_rng(0)
    params = [draw_vehicle(ALL, rng) for _ in range(4000)]
    drawn = {name: np.array([getattr(each, name) for each in params]) for name in LIMITS if name != "wind"}
    wind = np.array([each.wind for each in params])
    drawn["wind"] = np.hypot(*wind.T)
    shares = {
        name: (found - (low := getattr(ALL, name)[0])) / (getattr(ALL, name)[1] - low) for name, found in drawn.items()
    }
    shares |= {
        name: np.array([getattr(each, name) for each in params]) / (2 * np.pi)
        for name in ("mount_axis", "blind_azimuth")
    }
    shares["wind_direction"] = np.arctan2(*wind.T[::-1]) / (2 * np.pi) % 1
    for name, share in shares.items():
        assert share.min() >= 0 and share.max() <= 1, name
        np.testing.assert_allclose(np.quantile(share, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03, err_msg=name)
    correlation = np.corrcoef(list(shares.values()))
    assert np.abs(correlation - np.eye(len(shares))).max() < 0.08


def test_a_vehicle_is_no_heavier_than_its_rotors_carry_and_the_heaviest_climbs() -> None:
    heavy = Randomization(mass=(1.2, 1.2), thrust=(0.85, 0.85))
    plant = draw_vehicle(heavy, np.random.default_rng(0), most_load(Airframe()))
    lift = 0.9 * 38.0 * np.cos(0.5)
    assert plant.thrust == 0.85 and plant.mass == pytest.approx(0.85 * lift / (MASS * 10.31))
    with world() as simulation:
        begin(simulation, plant)
        fly(simulation, 30)
        assert simulation.velocity[0, 2] == pytest.approx(0.0, abs=0.02) and simulation.position[0, 2] > 3.0
        fly(simulation, 30, 0.0, 0.0, 1.0, 0.0)
        assert simulation.velocity[0, 2] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("ranges", "flyable"),
    [
        ({"mass": (0.8, 1.2), "thrust": (0.85, 1.15)}, True),
        ({"thrust": (0.8, 1.0)}, True),
        ({"thrust": (0.7, 1.0)}, False),  # 1 / 0.7 is above 1.26
        ({"mass": (1.3, 2.0)}, False),
        ({"mass": (0.5, 1.0)}, True),
        ({"mass": (0.4, 1.0)}, False),
        ({"wind": (0.0, 2.0)}, True),
    ],
)
def test_ranges_whose_vehicles_sink_or_rise_are_refused(ranges: dict[str, tuple[float, float]], flyable: bool) -> None:
    if flyable:
        NavigationEnv(1, randomize=Randomization(**ranges))
        return
    with pytest.raises(
        UavrlError, match=r"^randomize\.mass and randomize\.thrust must leave vehicles that can be flown"
    ):
        NavigationEnv(1, randomize=Randomization(**ranges))


def test_a_quantity_that_is_switched_off_changes_none_of_the_others() -> None:
    whole = draw_vehicle(ALL, np.random.default_rng(7))
    for name in LIMITS:
        part = draw_vehicle(
            Randomization(**{n: getattr(ALL, n) for n in LIMITS if n != name}), np.random.default_rng(7)
        )
        others = [f.name for f in fields(VehicleParams) if f.name != name]
        assert [getattr(part, n) for n in others] == [getattr(whole, n) for n in others]
        assert getattr(part, name) in (1.0, 0.0, None, (0.0, 0.0))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (
            {"mass": (1.2, 0.8)},
            r"mass must be two numbers in \[0.1, 10\], the lower one first, or null for off, got \[1.2",
        ),
        ({"thrust": (-1.0, 1.0)}, "thrust must be two numbers"),
        ({"action_delay": (0.0, 0.2)}, r"action_delay must be two numbers in \[0, 0.1\]"),
        ({"wind": (0.0, math.nan)}, "wind must be two numbers"),
        ({"dropout": 0.1}, "dropout must be two numbers"),
        ({"dropout": (0.1,)}, "dropout must be two numbers"),
        ({"dropout": ("0", "1")}, "dropout must be two numbers"),
        ({"dropout": (None, 0.1)}, "dropout must be two numbers"),
        ({"dropout": ([0.1], [0.1, 0.2])}, "dropout must be two numbers"),
    ],
)
def test_what_is_no_range_is_refused(given: dict[str, object], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        Randomization(**given)  # type: ignore[arg-type]


def test_every_quantity_has_its_limits() -> None:
    assert [field.name for field in fields(Randomization)] == list(LIMITS)
    assert NUM_RAYS == AZIMUTH_STEPS * 16
