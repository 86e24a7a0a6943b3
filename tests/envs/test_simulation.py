"""The flying quadrotor against what physics says, and distances against Bullet's when it looks at everything."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.vehicles import GRID, seen, world
from uavrl.envs import NavigationEnv
from uavrl.envs.bullet import CLOSEST_DISTANCE_CAP, SAMPLE_SPACING, pybullet, surface_samples
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.simulation import Simulation
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World, WorldConfig
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.vehicle import stopping_distance

NO_DRAG = Aerodynamics(force_coefficients=(0.0, 0.0, 0.0), moment_coefficients=(0.0, 0.0, 0.0))
QUAD = [[0, 1, 2], [0, 2, 3]]
WALL = Mesh([[2, -9, -9], [2, 9, -9], [2, 9, 9], [2, -9, 9]], QUAD)  # the plane x = 2
FLOOR = Mesh([[-20, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]], QUAD)
WING = Mesh([[0.2, -1, 0], [-0.2, -1, 0], [-0.2, 1, 0], [0.2, 1, 0]], QUAD)
START = np.array([[0.0, 0.0, 3.5]])
UAVS, PLANES = 8, 3


def steps(simulation: Simulation, count: int, *command: float) -> np.ndarray:
    """Steps with one command for all, or with none; gives what was touched in the last one."""
    for _ in range(count):
        touched = simulation.step(np.tile(command or np.zeros(4), (simulation.count, 1)))
    return touched


def restart(simulation: Simulation, rows: np.ndarray) -> None:
    simulation.reset(rows, START.repeat(len(rows), 0), np.zeros(len(rows)))


@pytest.mark.parametrize("lidar_mass", [0.83, 0.0])
def test_hover_holds(lidar_mass):
    with world(airframe=Airframe(lidar_mass=lidar_mass)) as simulation:
        for _ in range(100):
            steps(simulation, 1)
            assert np.abs(simulation.position - START).max() < 1e-3 and abs(simulation.yaw[0]) < 1e-6


def test_velocities_reverse_within_two_seconds():
    grid = GRID[GRID[:, 3] == 0]
    with world(len(grid)) as simulation:
        for commands in (-grid, grid):
            for _ in range(20):
                simulation.step(commands)
        assert np.abs(seen(simulation) - grid).max() < 0.1


@pytest.mark.parametrize("limit", [1.0, 4.0, 6.0])
def test_no_component_of_a_velocity_exceeds_its_limit(limit: float) -> None:
    with world(max_speed=limit) as simulation:
        steps(simulation, 40, 9, 0, 0, 0)
        assert simulation.velocity[0] == pytest.approx([limit, 0, 0], abs=0.2)
        place = simulation.position[0, 0]
        steps(simulation, 40, 0, 0, 0, 0)
        assert simulation.position[0, 0] - place < stopping_distance(limit) + 0.3
        steps(simulation, 20, 0, 0, 0, 9)
        assert simulation.angular_velocity[0, 2] == pytest.approx(2.0, abs=0.05)


def test_control_rate_does_not_change_the_path():
    def end(control_rate: int) -> np.ndarray:
        with world(control_rate=control_rate) as simulation:
            steps(simulation, control_rate, 2, 0, 1, 0)
            assert np.abs(simulation._controller.disturbance).max() < 0.2  # N: still air is not taken for wind
            return simulation.position

    for control_rate in (16, 48, 240):  # 15, 5 and 1 physics steps
        np.testing.assert_allclose(end(control_rate), end(10), atol=0.02)


def test_yaw_and_frame_at_reset():
    with world() as simulation:
        simulation.reset(np.array([0]), np.array([[1.0, 2.0, 3.0]]), np.array([np.pi / 2]))
        np.testing.assert_allclose(simulation.position, [[1, 2, 3]], atol=1e-12)
        np.testing.assert_allclose(simulation.lidar_position, [[1, 2, 3.1]], atol=1e-12)
        assert simulation.yaw[0] == pytest.approx(np.pi / 2) and not simulation.velocity.any()
        steps(simulation, 20, 1, 0, 0, 0)
        np.testing.assert_allclose(simulation.velocity, [[0, 1, 0]], atol=0.05)  # forward is now world y


def test_velocity_is_the_derivative_of_the_position():
    with world(physics_rate=240, control_rate=240) as simulation:  # one physics step per call
        steps(simulation, 100, 2, 1, 1, 2)
        before, speed = simulation.position, simulation.velocity
        steps(simulation, 1, 2, 1, 1, 2)
        np.testing.assert_allclose((simulation.position - before) * 240, (simulation.velocity + speed) / 2, atol=0.02)


def test_free_fall():
    with world(aerodynamics=NO_DRAG) as simulation:
        simulation.motors_on = False
        steps(simulation, 10)
        np.testing.assert_allclose(simulation.velocity, [[0, 0, -9.81]], atol=1e-9)
        # Semi-implicit Euler: g t² / 2 and half a step more.
        np.testing.assert_allclose(simulation.position, [[0, 0, 3.5 - 9.81 / 2 * (1 + 1 / 240)]], atol=1e-9)


@pytest.mark.parametrize("coefficient", [0.16327, 1.0])
def test_terminal_velocity(coefficient):
    with world(aerodynamics=Aerodynamics(force_coefficients=(0.2, 0.2, coefficient))) as simulation:
        simulation.motors_on = False
        steps(simulation, 150)
        expected = np.sqrt(2 * 2.307 * 9.81 / (1.225 * coefficient))
        assert -simulation.velocity[0, 2] == pytest.approx(expected, rel=1e-3)


def test_wind_carries_a_falling_vehicle_and_a_hovering_one_resists():
    with world(aerodynamics=Aerodynamics(wind=(5.0, 0.0, 0.0))) as simulation:
        steps(simulation, 3)
        assert 0.05 < simulation.velocity[0, 0] < 1.0
        steps(simulation, 60)
        assert abs(simulation.velocity[0, 0]) < 0.02
        assert simulation.rotation[0, 0, 2] < -0.1  # leaning into the wind
        simulation.motors_on = False
        steps(simulation, 300)
        assert simulation.velocity[0, 0] > 3.0


def test_applied_forces_and_torques_act_in_the_frames_they_are_meant_in():
    """Unequal rotors on a yawed vehicle: linear and angular acceleration by hand."""
    with world(aerodynamics=NO_DRAG, physics_rate=240, control_rate=240) as simulation:
        simulation.reset(np.array([0]), np.array([[0.0, 0.0, 9.0]]), np.array([0.7]))
        simulation._controller.thrusts = lambda rotation, twist: 1.53819e-5 * simulation.rotor_speed**2  # they keep it
        simulation.rotor_speed = np.array([[700.0, 600.0, 500.0, 600.0]])
        front, left, back, right = 1.53819e-5 * simulation.rotor_speed[0] ** 2
        steps(simulation, 1)
        moments = np.array([0.0, -0.275 * (front - back), 0.01534 * (left + right - front - back)])
        expected = moments / Airframe().combined_inertia / 240
        np.testing.assert_allclose(simulation.angular_velocity[0], expected, atol=2e-4)
        lift = front + left + back + right
        assert simulation.velocity[0, 2] == pytest.approx((lift / 2.307 - 9.81) / 240, abs=2e-4)


def test_random_commands_among_walls_are_recovered_from():
    rng, hits = np.random.default_rng(1), 0
    with world(4, (WALL, FLOOR)) as simulation:
        for _ in range(300):
            touched = simulation.step(rng.uniform(-2, 2, (4, 4)) + np.array([1, 0, -0.5, 0]))
            assert np.isfinite(simulation.position).all() and np.linalg.norm(simulation.velocity, axis=1).max() < 12
            hit = np.flatnonzero(touched)[::2]  # every other one is left to tumble
            restart(simulation, hit)
            hits += len(hit)
    assert hits > 3


def test_vehicles_neither_touch_nor_disturb_each_other():
    commands = np.random.default_rng(0).uniform(-2, 2, (60, 3, 4))

    def path(rows: list[int]) -> np.ndarray:
        with world(len(rows)) as simulation:
            places = []
            for step in commands:
                assert not simulation.step(step[rows]).any()
                places.append(simulation.position)
            return np.array(places)

    together = path([0, 1, 2])  # all start at one place
    for row in range(3):
        np.testing.assert_allclose(path([row])[:, 0], together[:, row], atol=1e-9)


def test_wall_is_reported_where_it_stands_and_forgotten_after_a_reset():
    with world(2, (WALL,)) as simulation:
        commands = np.array([[1.0, 0, 0, 0], [0.0, 0, 0, 0]])
        while not (touched := simulation.step(commands)).any():
            assert simulation.position[0, 0] < 2 - 0.3
        assert touched.tolist() == [True, False]
        assert simulation.position[0, 0] == pytest.approx(2 - 0.35, abs=0.06)
        restart(simulation, np.array([0]))
        assert not steps(simulation, 1).any()
        np.testing.assert_allclose(simulation.position[:1], START, atol=1e-3)


def pass_by(x: np.ndarray, y: float = 0.0, z: float = 3.5, yaw: float = 0.0) -> np.ndarray:
    """A plane's poses ``[24, 1, 4]`` in one control step."""
    return np.stack(np.broadcast_arrays(x, y, z, yaw), axis=-1)[:, None]


def test_touch_between_two_control_steps_is_reported():
    """A plane brushes past within one control step: far away at its start and at its end."""
    with world(plane_mesh=WING, plane_count=1) as simulation:
        x = np.linspace(-2.0, 2.0, 24)  # 40 m/s, in 17 cm strides
        assert simulation.step(np.zeros((1, 4)), pass_by(x, 1.3)).tolist() == [True]  # its wing tip reaches y = 0.3
        assert np.hypot(2.0, 1.3) - np.hypot(0.2, 1.0) > 0.7
        restart(simulation, np.array([0]))
        assert simulation.step(np.zeros((1, 4)), pass_by(x, 1.4)).tolist() == [False]  # the tip stays 5 cm away


@pytest.mark.parametrize("speed", [2.5, 4.0, 10.0, 30.0])
@pytest.mark.parametrize("height", [3.4, 3.5, 3.6])
def test_planes_do_not_tunnel(speed, height):
    with world(plane_mesh=WING, plane_count=1) as simulation:
        travelled, hit = -1.5, False
        while travelled < 1.5 and not hit:
            x = travelled + speed / 240 * np.arange(1, 25)
            hit = bool(simulation.step(np.zeros((1, 4)), pass_by(x, z=height))[0])
            travelled = x[-1]
        assert hit


def test_yawed_plane_reaches_where_its_wing_is():
    with world(plane_mesh=WING, plane_count=1) as simulation:
        for yaw, touched in ((0.0, False), (np.pi / 2, True)):
            assert simulation.step(np.zeros((1, 4)), pass_by(np.ones(24), yaw=yaw))[0] == touched


def test_large_meshes_are_split_without_loss():
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.normal(size=(300, 3)), rng.integers(300, size=(1000, 3)))
    parts = mesh.split(np.arange(1000) // 64)
    assert max(len(part.faces) for part in parts) == 64
    corners = np.concatenate([part.vertices[part.faces] for part in parts])
    np.testing.assert_array_equal(corners, mesh.vertices[mesh.faces])


def test_commands_are_clipped_and_nan_refused():
    with world() as one, world() as other:
        steps(one, 1, 9, -9, np.inf, 3)
        steps(other, 1, 2, -2, 2, 2)
        np.testing.assert_array_equal(one.position, other.position)
        with pytest.raises(ValueError, match="Actions must be numbers, got NaN"):
            steps(one, 1, np.nan, 0, 0, 0)
        with pytest.raises(ValueError, match="shape"):
            one.step(np.zeros(4))
        with pytest.raises(ValueError, match="shape"):
            one.place_planes(np.zeros((1, 4)))
        one.close()  # a second time is fine


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


def looked_at_everything(simulation: Simulation, planes: np.ndarray) -> np.ndarray:
    """Without any bound: all bodies, planes where they are, all triangles within 5 m."""
    found = np.full(simulation.count, 5.0)
    for plane, (x, y, z, yaw) in zip(simulation._planes.bodies, planes, strict=True):
        turn = (0, 0, np.sin(yaw / 2), np.cos(yaw / 2))
        pybullet.resetBasePositionAndOrientation(plane, (x, y, z), turn, physicsClientId=simulation._client)
    for row, vehicle in enumerate(simulation._vehicles):
        for body in simulation._statics + simulation._planes.bodies:
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
        expected.append(looked_at_everything(simulation, places[UAVS:]))
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


def test_a_plane_that_stands_far_away_is_met_where_it_stands() -> None:
    plane = plane_mesh(1.2)
    simulation = Simulation([], 1, plane_mesh=plane, plane_count=2)
    simulation.reset(np.array([0]), np.array([[0.0, 0.0, 3.0]]), np.zeros(1))
    simulation.place_planes(np.array([[-90.0, 0.0, 3.0, 0.0], [20.0, 0.0, 3.0, np.pi]]))
    touched = [bool(simulation.step(np.array([[2.0, 0.0, 0.0, 0.0]]))[0]) for _ in range(120)]
    simulation.close()
    met = 20.0 - plane.vertices[:, 0].max() - simulation.airframe.collision_radius
    assert touched.index(True) * 0.1 == pytest.approx(met / 2.0, abs=0.8)


def test_a_plane_that_has_flown_away_leaves_nothing_behind() -> None:
    simulation = Simulation([], 1, plane_mesh=plane_mesh(1.2), plane_count=1)
    simulation.reset(np.array([0]), np.array([[0.0, 0.0, 3.0]]), np.zeros(1))
    simulation.place_planes(np.array([[3.0, 0.0, 3.0, 0.0]]))
    for step in range(40):  # it leaves to the left at 4 m/s
        left = 4.0 * (step + np.arange(1, simulation.substeps + 1) / simulation.substeps) / 10
        path = np.stack([0 * left + 3.0, left, 0 * left + 3.0, 0 * left + np.pi / 2], -1)[:, None]
        assert not simulation.step(np.array([[2.0, 0.0, 0.0, 0.0]]), path)[0]
    assert simulation.position[0, 0] > 5.0, "it flew through where the plane was"
    simulation.close()


def test_a_plane_that_enters_anew_within_a_step_is_met() -> None:
    simulation = Simulation([], 1, plane_mesh=plane_mesh(1.2), plane_count=1)
    simulation.reset(np.array([0]), np.array([[0.0, 0.0, 3.0]]), np.zeros(1))
    path = np.zeros((simulation.substeps, 1, 4))
    path[:, 0, 0] = 500.0
    path[12:, 0] = 0.0, 0.0, 3.0, 0.0
    assert simulation.step(np.zeros((1, 4)), path)[0]
    simulation.close()


def test_planes_that_are_far_away_change_nothing_to_the_last_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    valley = World(WorldConfig(seeds=(0,), size=(26.0, 20.0), obstacles=10))

    def flown() -> tuple[np.ndarray, np.ndarray]:
        rng, found, touched = np.random.default_rng(0), [], []
        simulation = Simulation(valley.meshes, UAVS, plane_mesh=plane_mesh(1.2), plane_count=PLANES)
        starts = rng.uniform([-12, -9, 1.0, -3], [12, 9, 6, 3], (UAVS, 4))
        simulation.reset(np.arange(UAVS), starts[:, :3], starts[:, 3])
        planes, speeds = rng.uniform([-12, -9, 1, -3], [12, 9, 6, 3], (PLANES, 4)), rng.uniform(-4, 4, (PLANES, 2))
        for step in range(20):
            times = step / 10 + np.arange(1, simulation.substeps + 1) / simulation.substeps / 10
            path = np.tile(planes, (simulation.substeps, 1, 1))
            path[..., :2] += 3 * times[:, None, None] * speeds
            touched.append(simulation.step(rng.uniform(-2, 2, (UAVS, 4)), path))
            found.append(np.concatenate([simulation.position, simulation.velocity], 1))
        simulation.close()
        return np.array(found), np.array(touched)

    near = flown()
    monkeypatch.setattr("uavrl.envs.plane_bodies.ROOM", 1e6)
    for one, other in zip(near, flown(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert near[1].any() and not near[1].all()


def test_samples_lie_on_the_surface_and_leave_no_part_of_it_out() -> None:
    pole = Mesh([[0, 0, 0], [0.1, 0, 0], [0, 0, 9]], [[0, 1, 2]])
    samples = surface_samples(pole, SAMPLE_SPACING)
    assert not samples[:, 1].any() and (samples.min(0) >= 0).all()
    edge = np.stack([0 * np.arange(91), 0 * np.arange(91), np.arange(91) / 10], -1)
    assert np.linalg.norm(edge[:, None] - samples, axis=-1).min(1).max() < SAMPLE_SPACING


def test_the_closest_distance_is_that_of_asking_bullet_about_every_body() -> None:
    env = NavigationEnv(num_uavs=4, world={"seeds": (100, 101), "obstacles": 45, "planes": 2}, measure_clearance=True)
    env.reset()
    simulation, rng = env.simulation, np.random.default_rng(0)
    bodies = [*simulation._statics, *simulation._planes.bodies]
    found = []
    for _ in range(4):
        origins = np.stack([env.world.places[place].origin for place in rng.integers(2, size=4)])
        places = np.column_stack([origins + rng.uniform([-20, -15], [20, 15], (4, 2)), rng.uniform(0.5, 6, 4)])
        simulation.reset(np.arange(4), places, rng.uniform(-3, 3, 4))
        told = {"distance": CLOSEST_DISTANCE_CAP, "physicsClientId": simulation._client}
        for vehicle, distance in zip(simulation._vehicles, simulation.closest_distance(), strict=True):
            points = [point[8] for body in bodies for point in pybullet.getClosestPoints(vehicle, body, **told)]
            assert distance == min([CLOSEST_DISTANCE_CAP, *points])
            found.append(float(distance))
    assert min(found) < 0.5 < 1.0 < max(found)
    env.close()
