"""The flying quadrotor against what physics says."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.vehicles import GRID, seen, world
from uavrl.envs.bullet import SAMPLE_SPACING, pybullet, surface_samples
from uavrl.envs.mesh import Mesh
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.simulation import Simulation
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World, WorldConfig

NO_DRAG = Aerodynamics(force_coefficients=(0.0, 0.0, 0.0), moment_coefficients=(0.0, 0.0, 0.0))
WALL = Mesh([[2, -9, -9], [2, 9, -9], [2, 9, 9], [2, -9, 9]], [[0, 1, 2], [0, 2, 3]])  # the plane x = 2
WING = Mesh([[0.2, -1, 0], [-0.2, -1, 0], [-0.2, 1, 0], [0.2, 1, 0]], [[0, 1, 2], [0, 2, 3]])


UAVS, PLANES = 8, 3


def command(*entries: float) -> np.ndarray:
    return np.array([entries])


# ---------------------------------------------------------------------- control


@pytest.mark.parametrize("lidar_mass", [0.83, 0.0])
def test_hover_holds(lidar_mass):
    with world(airframe=Airframe(lidar_mass=lidar_mass)) as simulation:
        for _ in range(100):
            simulation.step(np.zeros((1, 4)))
            assert np.abs(simulation.position - [0, 0, 3.5]).max() < 1e-3
            assert abs(simulation.yaw[0]) < 1e-6


def test_velocities_reverse_within_two_seconds():
    grid = GRID[GRID[:, 3] == 0]
    with world(len(grid)) as simulation:
        for commands, steps in ((-grid, 20), (grid, 20)):
            for _ in range(steps):
                simulation.step(commands)
        assert np.abs(seen(simulation) - grid).max() < 0.1


def test_control_rate_does_not_change_the_flight():
    def flight(control_rate: int) -> np.ndarray:
        with world(control_rate=control_rate) as simulation:
            for _ in range(control_rate):
                simulation.step(command(2, 0, 1, 0))
            assert np.abs(simulation._controller.disturbance).max() < 0.2  # N: still air is not taken for wind
            return simulation.position

    for control_rate in (16, 48, 240):  # 15, 5 and 1 physics steps
        np.testing.assert_allclose(flight(control_rate), flight(10), atol=0.02)


def test_yaw_and_frame_at_reset():
    with world() as simulation:
        simulation.reset(np.array([0]), np.array([[1.0, 2.0, 3.0]]), np.array([np.pi / 2]))
        np.testing.assert_allclose(simulation.position, [[1, 2, 3]], atol=1e-12)
        np.testing.assert_allclose(simulation.lidar_position, [[1, 2, 3.1]], atol=1e-12)
        assert simulation.yaw[0] == pytest.approx(np.pi / 2) and not simulation.velocity.any()
        for _ in range(20):
            simulation.step(command(1, 0, 0, 0))
        np.testing.assert_allclose(simulation.velocity, [[0, 1, 0]], atol=0.05)  # forward is now world y


def test_velocity_is_the_derivative_of_the_position():
    with world(physics_rate=240, control_rate=240) as simulation:  # one physics step per call
        for _ in range(100):
            simulation.step(command(2, 1, 1, 2))
        before, speed = simulation.position, simulation.velocity
        simulation.step(command(2, 1, 1, 2))
        np.testing.assert_allclose((simulation.position - before) * 240, (simulation.velocity + speed) / 2, atol=0.02)


# ---------------------------------------------------------------------- forces


def test_free_fall():
    with world(aerodynamics=NO_DRAG) as simulation:
        simulation.motors_on = False
        for _ in range(10):
            simulation.step(np.zeros((1, 4)))
        np.testing.assert_allclose(simulation.velocity, [[0, 0, -9.81]], atol=1e-9)
        # Semi-implicit Euler: g t² / 2 and half a step more.
        np.testing.assert_allclose(simulation.position, [[0, 0, 3.5 - 9.81 / 2 * (1 + 1 / 240)]], atol=1e-9)


@pytest.mark.parametrize("coefficient", [0.16327, 1.0])
def test_terminal_velocity(coefficient):
    air = Aerodynamics(force_coefficients=(0.2, 0.2, coefficient))
    with world(aerodynamics=air) as simulation:
        simulation.motors_on = False
        for _ in range(150):
            simulation.step(np.zeros((1, 4)))
        expected = np.sqrt(2 * 2.307 * 9.81 / (1.225 * coefficient))
        assert -simulation.velocity[0, 2] == pytest.approx(expected, rel=1e-3)


def test_wind_carries_a_falling_vehicle_and_a_hovering_one_resists():
    with world(aerodynamics=Aerodynamics(wind=(5.0, 0.0, 0.0))) as simulation:
        for _ in range(3):
            simulation.step(np.zeros((1, 4)))
        assert 0.05 < simulation.velocity[0, 0] < 1.0
        for _ in range(60):
            simulation.step(np.zeros((1, 4)))
        assert abs(simulation.velocity[0, 0]) < 0.02
        assert simulation.rotation[0, 0, 2] < -0.1  # leaning into the wind
        simulation.motors_on = False
        for _ in range(300):
            simulation.step(np.zeros((1, 4)))
        assert simulation.velocity[0, 0] > 3.0


def test_applied_forces_and_torques_act_in_the_frames_they_are_meant_in():
    """One rotor alone, on a yawed vehicle without weight on the others: linear and angular acceleration by hand."""
    air, airframe = NO_DRAG, Airframe()
    with world(aerodynamics=air, physics_rate=240, control_rate=240) as simulation:
        simulation.reset(np.array([0]), np.array([[0.0, 0.0, 9.0]]), np.array([0.7]))
        simulation._controller.thrusts = lambda rotation, twist: (
            simulation.airframe.thrust_coefficient * (simulation.rotor_speed**2)
        )  # the rotors stay at the speeds that they have
        speeds = np.array([[700.0, 600.0, 500.0, 600.0]])
        simulation.rotor_speed = speeds
        simulation.step(np.zeros((1, 4)))
        thrusts = 1.53819e-5 * speeds[0] ** 2
        moments = [
            0.0,
            -0.275 * (thrusts[0] - thrusts[2]),
            0.01534 * (thrusts[1] + thrusts[3] - thrusts[0] - thrusts[2]),
        ]
        expected = np.array(moments) / airframe.combined_inertia / 240
        np.testing.assert_allclose(simulation.angular_velocity[0], expected, atol=2e-4)
        linear = simulation.velocity[0, 2]
        assert linear == pytest.approx((thrusts.sum() / 2.307 - 9.81) / 240, abs=2e-4)


# ---------------------------------------------------------------------- long runs, independence, repetition


def test_random_flight_among_walls_recovers():
    rng, floor = np.random.default_rng(1), Mesh([[-20, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]], WALL.faces)
    hits = 0
    with world(4, (WALL, floor)) as simulation:
        for _ in range(300):
            touched = simulation.step(rng.uniform(-2, 2, (4, 4)) + command(1, 0, -0.5, 0))
            assert np.isfinite(simulation.position).all() and np.linalg.norm(simulation.velocity, axis=1).max() < 12
            if touched.any():
                hit = np.flatnonzero(touched)[::2]  # every other one is left to tumble
                simulation.reset(hit, np.tile([0.0, 0.0, 3.5], (len(hit), 1)), np.zeros(len(hit)))
                hits += len(hit)
    assert hits > 3


def test_vehicles_neither_touch_nor_disturb_each_other():
    rng = np.random.default_rng(0)
    commands = rng.uniform(-2, 2, (60, 3, 4))

    def flight(rows: list[int]) -> np.ndarray:
        with world(len(rows)) as simulation:
            path = []
            for step in commands:
                assert not simulation.step(step[rows]).any()
                path.append(simulation.position)
            return np.array(path)

    together = flight([0, 1, 2])  # all start at one place
    for row in range(3):
        np.testing.assert_allclose(flight([row])[:, 0], together[:, row], atol=1e-9)


# ---------------------------------------------------------------------- contacts


def test_wall_is_reported_where_it_stands_and_forgotten_after_a_reset():
    with world(2, (WALL,)) as simulation:
        commands = np.array([[1.0, 0, 0, 0], [0.0, 0, 0, 0]])
        while not (touched := simulation.step(commands)).any():
            assert simulation.position[0, 0] < 2 - 0.3
        assert touched.tolist() == [True, False]
        assert simulation.position[0, 0] == pytest.approx(2 - 0.35, abs=0.06)
        simulation.reset(np.array([0]), np.array([[0.0, 0.0, 3.5]]), np.zeros(1))
        assert not simulation.step(np.zeros((2, 4))).any()
        np.testing.assert_allclose(simulation.position[0], [0, 0, 3.5], atol=1e-3)


def test_touch_between_two_control_steps_is_reported():
    """A plane brushes past within one control step: far away at its start and at its end."""
    with world(plane_mesh=WING, plane_count=1) as simulation:
        x = np.linspace(-2.0, 2.0, 24)  # 40 m/s, in 17 cm strides
        path = np.stack([x, np.full(24, 1.3), np.full(24, 3.5), np.zeros(24)], axis=1)[:, None]
        assert simulation.step(np.zeros((1, 4)), path).tolist() == [True]  # its wing tip reaches y = 0.3
        assert np.hypot(2.0, 1.3) - np.hypot(0.2, 1.0) > 0.7
        simulation.reset(np.array([0]), np.array([[0.0, 0.0, 3.5]]), np.zeros(1))
        path[..., 1] = 1.4  # the wing tip stays 5 cm away
        assert simulation.step(np.zeros((1, 4)), path).tolist() == [False]


@pytest.mark.parametrize("speed", [2.5, 4.0, 10.0, 30.0])
@pytest.mark.parametrize("height", [3.4, 3.5, 3.6])
def test_planes_do_not_tunnel(speed, height):
    with world(plane_mesh=WING, plane_count=1) as simulation:
        travelled, hit = -1.5, False
        while travelled < 1.5 and not hit:
            x = travelled + speed / 240 * np.arange(1, 25)
            path = np.stack([x, np.zeros(24), np.full(24, height), np.zeros(24)], axis=1)[:, None]
            hit = bool(simulation.step(np.zeros((1, 4)), path)[0])
            travelled = x[-1]
        assert hit


def test_yawed_plane_reaches_where_its_wing_is():
    with world(plane_mesh=WING, plane_count=1) as simulation:
        along, across = np.array([[1.0, 0.0, 3.5, 0.0]]), np.array([[1.0, 0.0, 3.5, np.pi / 2]])
        assert not simulation.step(np.zeros((1, 4)), np.tile(along, (24, 1, 1))).any()
        assert simulation.step(np.zeros((1, 4)), np.tile(across, (24, 1, 1))).all()


def test_large_meshes_are_split_without_loss():
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.normal(size=(300, 3)), rng.integers(300, size=(1000, 3)))
    parts = mesh.split(np.arange(1000) // 64)
    assert max(len(part.faces) for part in parts) == 64
    np.testing.assert_array_equal(
        np.concatenate([part.vertices[part.faces] for part in parts]), mesh.vertices[mesh.faces]
    )


# ---------------------------------------------------------------------- what is refused


def test_commands_are_clipped_and_nan_refused():
    with world() as one, world() as other:
        one.step(command(9, -9, np.inf, 3))
        other.step(command(2, -2, 2, 2))
        np.testing.assert_array_equal(one.position, other.position)
        with pytest.raises(ValueError, match="NaN"):
            one.step(command(np.nan, 0, 0, 0))
        with pytest.raises(ValueError, match="shape"):
            one.step(np.zeros(4))
        with pytest.raises(ValueError, match="shape"):
            one.place_planes(np.zeros((1, 4)))


@pytest.mark.parametrize(
    "settings",
    [
        {"count": 0},
        {"count": 1, "control_rate": 7},
        {"count": 1, "plane_count": 1},
        {"count": 1, "aerodynamics": Aerodynamics(gust_intensity=1.0)},
    ],
)
def test_settings_that_make_no_world_are_refused(settings):
    with pytest.raises(ValueError):
        Simulation([], **settings)


# ---------------------------------------------------------------------- clearance


def looked_at_everything(simulation: Simulation) -> np.ndarray:
    """Without any bound: all bodies, all triangles within 5 m."""
    found = np.full(simulation.count, 5.0)
    for row, vehicle in enumerate(simulation._vehicles):
        for body in simulation._statics + simulation._planes:
            points = pybullet.getClosestPoints(vehicle, body, 5.0, physicsClientId=simulation._client)
            found[row] = min([found[row], *(point[8] for point in points)])
    return found


@pytest.mark.parametrize("seed", [0, 1])
def test_the_closest_distance_is_that_of_looking_at_everything(seed: int) -> None:
    valley, rng = World(WorldConfig(seeds=(seed,), size=(26.0, 20.0), obstacles=20)), np.random.default_rng(seed)
    simulation = Simulation(valley.meshes, UAVS, plane_mesh=plane_mesh(2.0), plane_count=PLANES)
    found, expected = [], []
    for _ in range(15):
        places = rng.uniform([-12, -9, 0.3, -3], [12, 9, 9, 3], (UAVS + PLANES, 4))
        simulation.place_planes(places[UAVS:])
        simulation.reset(np.arange(UAVS), places[:UAVS, :3], places[:UAVS, 3])
        simulation.step(rng.uniform(-2, 2, (UAVS, 4)))  # tilts them
        found.append(simulation.closest_distance())
        expected.append(looked_at_everything(simulation))
    simulation.close()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert np.min(expected) < 0.0 < 1.5 < np.max(expected), "inside and far from things"


def test_a_plane_is_found_beyond_and_before_the_static_geometry() -> None:
    wall = Mesh([[4, -9, -9], [4, 9, -9], [4, 9, 9], [4, -9, 9]], [[0, 1, 2], [0, 2, 3]])  # the plane x = 4
    plane = plane_mesh(2.0)
    nose = float(plane.vertices[:, 0].max())
    for meshes, away, expected in (([wall], 3.0, 3.0 - 0.35), ([wall], 9.0, 4.0 - 0.35), ([], 9.0, 5.0)):
        simulation = Simulation(meshes, 1, plane_mesh=plane, plane_count=1)
        simulation.place_planes(np.array([[-away - nose, 0.0, 0.0, 0.0]]))
        assert simulation.closest_distance()[0] == pytest.approx(expected, abs=0.01)
        simulation.close()


def test_samples_lie_on_the_surface_and_leave_no_part_of_it_out() -> None:
    pole = Mesh([[0, 0, 0], [0.1, 0, 0], [0, 0, 9]], [[0, 1, 2]])
    samples = surface_samples(pole, SAMPLE_SPACING)
    assert not samples[:, 1].any() and (samples.min(0) >= 0).all()
    edge = np.stack([0 * np.arange(91), 0 * np.arange(91), np.arange(91) / 10], -1)
    assert np.linalg.norm(edge[:, None] - samples, axis=-1).min(1).max() < SAMPLE_SPACING
