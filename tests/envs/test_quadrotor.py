"""Masses, rotors, drag, gusts and the mixer against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uavrl.envs.controller import Mixer, feasible_command, limit_force, tilt_error, to_world
from uavrl.envs.quadrotor import Aerodynamics, Airframe, drag, gust_path, mixing_matrix
from uavrl_onboard.geometry import rotations_of


def test_centre_of_mass_and_inertia():
    airframe = Airframe()
    assert airframe.total_mass == pytest.approx(2.307)
    assert airframe.centre_of_mass == pytest.approx((0, 0, 0.03597746))  # 0.83 x 0.1 / 2.307
    # Solid cylinder: 0.83 (3 x 0.0515² + 0.072²) / 12 = 0.00090890, 0.83 x 0.0515² / 2 = 0.00110068.
    # Two masses 0.1 m apart: 1.477 x 0.83 / 2.307 x 0.01 = 0.00531387.
    assert airframe.combined_inertia == pytest.approx((0.01774277, 0.01774277, 0.02290068), abs=1e-8)
    bare = Airframe(lidar_mass=0.0)
    assert bare.combined_inertia == (0.01152, 0.01152, 0.0218) and bare.centre_of_mass == (0, 0, 0)
    assert bare.hover_speed == pytest.approx(485.28, abs=0.01)  # sqrt(1.477 x 9.81 / 4 / 1.53819e-5)


def test_mixing_matrix():
    front, left = mixing_matrix(Airframe())[:, 0], mixing_matrix(Airframe())[:, 1]
    assert front.tolist() == [1.0, 0.0, -0.275, -0.01534]  # lifting the nose is a negative turn about y
    assert left.tolist() == [1.0, 0.275, 0.0, 0.01534]


def test_drag_matches_hector_quadrotor():
    coefficients = Aerodynamics().coefficients
    np.testing.assert_allclose(coefficients, [[0.12, 0.12, 0.1], [0.074156, 0.074156, 0.050643]], rtol=1e-4)
    twist = np.array([[[2.0, 0.0, 0.0], [0.0, 0.0, -2.0]]])
    np.testing.assert_allclose(drag(twist, coefficients)[0], [[-0.48, 0, 0], [0, 0, 0.202572]], rtol=1e-4)


@given(st.lists(st.floats(-50, 50), min_size=6, max_size=6))
def test_drag_never_adds_energy(entries):
    twist = np.reshape(entries, (1, 2, 3))
    power = (drag(twist, Aerodynamics().coefficients) * twist).sum()
    assert power <= 0


def test_rotations_of_quaternions():
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    np.testing.assert_allclose(rotations_of(quaternions), Rotation.from_quat(quaternions).as_matrix(), atol=1e-14)


def test_gusts_have_their_intensity_and_memory():
    rng = np.random.default_rng(0)
    first = gust_path(np.zeros((500, 3)), intensity=1.5, time_constant=1.0, dt=0.1, steps=50, rng=rng)
    late = gust_path(first[-1], intensity=1.5, time_constant=1.0, dt=0.1, steps=150, rng=rng)[50:]
    assert late.std() == pytest.approx(1.5, rel=0.05) and abs(late.mean()) < 0.1
    correlation = (late[10:] * late[:-10]).mean() / late.var()
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.05)


@given(st.floats(0, 38), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.03, 0.03))
def test_mixer_is_exact_where_the_rotors_can_and_within_limits_elsewhere(thrust, roll, pitch, yaw):
    wrench = np.array([[thrust, roll, pitch, yaw]])
    thrusts = Mixer(Airframe())(wrench)
    assert (thrusts >= 0).all() and (thrusts <= 9.5).all()
    wanted = np.linalg.solve(mixing_matrix(Airframe()), wrench[0])
    if (wanted >= 0).all() and (wanted <= 9.5).all():
        np.testing.assert_allclose(thrusts[0], wanted, atol=1e-12)


def test_mixer_gives_up_yaw_first_and_roll_last():
    matrix = mixing_matrix(Airframe())
    thrust, roll, pitch, yaw = matrix @ Mixer(Airframe())(np.array([[38.0, 0.5, 0.0, 0.3]]))[0]
    assert roll == pytest.approx(0.5) and pitch == pytest.approx(0.0, abs=1e-12)
    assert thrust == pytest.approx(38 - 4 * 0.5 / 0.55)  # just room for the rotor at the left
    assert 0 <= yaw < 0.3
    _, roll, _, _ = matrix @ Mixer(Airframe())(np.array([[20.0, 99.0, 0.0, 0.0]]))[0]
    assert roll == pytest.approx(9.5 * 0.275)  # one rotor full, the other off


def test_mixer_row_does_not_depend_on_other_rows():
    mixer, rng = Mixer(Airframe()), np.random.default_rng(0)
    wrench = rng.normal([22, 0, 0, 0], [10, 1, 1, 0.2], (50, 4))
    alone = np.concatenate([mixer(row[None]) for row in wrench])
    np.testing.assert_allclose(mixer(wrench), alone, atol=1e-12)


def test_command_frame_is_yaw_aligned_even_when_tilted():
    tilted = Rotation.from_euler("ZYX", [np.pi / 2, 0.4, 0.0]).as_matrix()[None]  # yaw, then pitch
    velocity, turning = to_world(np.array([[1.0, 0.5, 2.0, 0.0]]), tilted, np.zeros(1))
    np.testing.assert_allclose(velocity, [[-0.5, 1.0, 2.0]], atol=1e-12)
    assert not turning.any()


def test_only_circles_tighter_than_the_tilt_limit_are_slowed():
    commands = np.array([[2.0, 2.0, 2.0, 0.0], [2.0, 0.0, 0.0, 2.0], [2.0, -2.0, 0.0, -2.0]])
    slowed = feasible_command(commands, Airframe(), Aerodynamics(force_coefficients=(0.0, 0.0, 0.0)))
    np.testing.assert_array_equal(slowed[:2], commands[:2])
    speed = 9.81 * np.tan(0.5) / 2  # the centripetal acceleration is at the limit
    np.testing.assert_allclose(slowed[2], [speed / np.sqrt(2), -speed / np.sqrt(2), 0, -2.0])


@settings(max_examples=50)
@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3))
def test_forces_stay_within_tilt_and_thrust(entries):
    force = limit_force(np.array([entries]), Airframe())[0]
    assert np.arctan2(np.hypot(force[0], force[1]), force[2]) <= 0.5 + 1e-9
    assert np.linalg.norm(force) <= 38.0


def test_tilt_error_points_the_short_way():
    directions = Rotation.from_euler("x", [[0.2], [-0.2], [3.0]]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(tilt_error(directions)[:, 0], 2 * np.sin([0.1, -0.1, 1.5]), atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (Airframe, "lidar_position", (0.1, 0.0, 0.1)),
        (Airframe, "mass", 0.0),
        (Airframe, "max_total_thrust", 20.0),
        (Airframe, "motor_time_constant", 0.0),
        (Aerodynamics, "air_density", -1.0),
        (Aerodynamics, "gust_intensity", -1.0),
        (Aerodynamics, "gust_time_constant", 0.0),
    ],
)
def test_what_cannot_fly_and_air_that_pushes_are_refused(kind, name, value):
    with pytest.raises(ValueError, match="must"):
        kind(**{name: value})
