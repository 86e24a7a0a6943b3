"""A flight is kept as it was flown: its numbers are the environment's, and its file gives them back."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.flights import PERCEPTION, SEED, STEPS, flying_env, small_env, small_recording
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.record import record_flight, record_flights
from uavrl.evaluation.recording import load_recording, save_recording, thinned
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.policies.baselines import StraightPolicy
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl_onboard.guards.settings import guard_settings


def same(a: Any, b: Any) -> None:
    for field in fields(a):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other, err_msg=field.name)
            assert one.dtype == other.dtype
        else:
            assert one == other, field.name


def test_every_moment_is_kept() -> None:
    for flight, task in zip(small_recording().flights, (1, 5), strict=True):
        steps, moments = flight.summary.steps, flight.summary.steps + 1
        assert flight.summary.task == task and 1 <= steps <= STEPS
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(
            ("times", "distances", "clearances", "point_ends"), (moments,)
        )
        shapes |= {"positions": (moments, 3), "attitudes": (moments, 4), "velocities": (moments, 3), "goal": (3,)}
        shapes |= {"observations": (moments, 105), "actions": (steps, 4), "rewards": (steps, 6), "risks": (0,)}
        shapes |= {"planes": (moments, 2, 4), "faces": (moments, 32)}
        assert {name: getattr(flight, name).shape for name in shapes} == shapes
        assert flight.point_ends[-1] == len(flight.points)
        np.testing.assert_allclose(np.diff(flight.times), 0.1)


def test_positions_are_the_valleys_own_and_agree_with_distances_and_velocities() -> None:
    replay = small_recording()
    assert {f.summary.world_seed for f in replay.flights} == set(replay.sceneries)
    for flight in replay.flights:
        assert (np.abs(flight.positions[:, :2]) < replay.scenery(flight).size / 2).all()
        np.testing.assert_allclose(np.linalg.norm(flight.positions - flight.goal, axis=1), flight.distances, atol=1e-4)
        mean = (flight.velocities[1:] + flight.velocities[:-1]) / 2
        np.testing.assert_allclose(np.diff(flight.positions, axis=0) / 0.1, mean, atol=0.15)
        flown = np.linalg.norm(np.diff(flight.positions, axis=0), axis=1).sum()
        assert flown == pytest.approx(flight.summary.flown, rel=1e-4)


def test_the_cloud_that_is_kept_gives_the_faces_that_are_kept() -> None:
    flight = small_recording().flights[0]
    for moment in (0, 3, flight.summary.steps):
        cloud = torch.from_numpy(flight.cloud(moment))
        torch.testing.assert_close(truncated_icosahedron(cloud), torch.from_numpy(flight.faces[moment]))
        assert len(cloud)


def test_points_lie_on_the_ground_or_above_it() -> None:
    replay = small_recording()
    flight = replay.flights[0]
    scenery = replay.scenery(flight)
    turn = Rotation.from_quat(flight.attitudes[4])
    points = turn.apply(flight.cloud(4) + scenery.sensor) + flight.positions[4]
    above = points[:, 2] - HeightField(scenery.heights, tuple(scenery.size.tolist())).at(points[:, :2])
    assert above.min() > -0.02
    assert (np.abs(above) < 0.02).sum() > 100


def test_planes_fly_between_the_moments() -> None:
    for flight in small_recording().flights:
        moved = np.linalg.norm(np.diff(flight.planes[..., :2], axis=0), axis=-1) / 0.1
        assert ((moved > 2.4) & (moved < 4.1)).mean() > 0.9  # but where one enters anew


def test_what_is_seen_to_move_is_kept_where_a_plane_flies() -> None:
    env = flying_env(6, None, 1, 60, "perception.motion=12")
    try:
        flight = record_flight(env, lambda state: state.set("action", torch.zeros(1, 4)), 1, seed=SEED, max_points=50)
    finally:
        env.close()
    assert flight.objects.shape == (flight.summary.steps + 1, 3, 7)
    moments, which = np.nonzero(flight.objects[..., 6])
    assert len(moments) > 10
    seen, planes = flight.objects[moments, which], flight.planes[moments, :, :3]
    apart = np.linalg.norm(planes - seen[:, None, :3], axis=-1)
    there = apart.min(1) < 0.5  # not where it is believed to fly on behind an obstacle
    assert there.mean() > 0.3
    nearest = planes[np.arange(len(planes)), apart.argmin(1)]
    flies = (flight.planes[(moments + 1).clip(max=len(flight.planes) - 1), apart.argmin(1), :3] - nearest) / 0.1
    lengths = np.linalg.norm(flies, axis=-1) * np.linalg.norm(seen[:, 3:6], axis=-1)
    moved = there & (lengths > 0)
    assert np.median((flies * seen[:, 3:6]).sum(-1)[moved] / lengths[moved]) > 0.8, "it is said to fly where it flies"


def test_where_the_map_leads_is_kept() -> None:
    """Nothing is on the way yet at the beginning: it leads straight to the goal."""
    env = flying_env(0, None, 1, 60, guards=guard_settings("map"))
    try:
        flight = record_flight(env, lambda state: state.set("action", torch.zeros(1, 4)), 1, seed=SEED, max_points=50)
    finally:
        env.close()
    (x, y), bearing = (flight.goal - flight.positions[0])[:2], flight.bearings[0]
    assert [np.cos(bearing), np.sin(bearing)] == pytest.approx(np.array([x, y]) / np.hypot(x, y), abs=1e-4)
    assert flight.bearings.shape == flight.times.shape and np.isfinite(flight.bearings).all()
    assert small_recording().flights[0].bearings.shape == (0,)


def test_without_sight_of_motion_nothing_is_seen_to_move() -> None:
    assert small_recording().flights[0].objects.shape == (small_recording().flights[0].summary.steps + 1, 0, 7)


def test_a_flight_is_that_of_the_evaluation() -> None:
    tasks = (0, 1, 2)
    env = make_env(small_env(), PERCEPTION, seed=SEED, num_uavs=2, measure_clearance=True)
    try:
        evaluated = rollout_episodes(env, StraightPolicy(3.5), len(tasks))
    finally:
        env.close()
    kept = [flight.summary for flight in small_recording(0, tasks).flights]
    for one, other in zip(kept, evaluated, strict=True):
        for name in ("task", "world_seed", "outcome", "steps"):
            assert getattr(one, name) == getattr(other, name)
        assert one.flown == pytest.approx(other.flown, abs=1e-4)
        assert one.clearance == pytest.approx(other.clearance, abs=1e-3)


def test_a_flight_tells_where_it_went() -> None:
    flight = small_recording().flights[0]
    altitudes = flight.positions[1:, 2].astype(float)
    half = np.array(small_env().world.size) / 2
    assert flight.position_stats["steps"] == flight.summary.steps
    assert flight.position_stats["altitude"]["p50"] == pytest.approx(np.median(altitudes))
    walls = (half - np.abs(flight.positions[1:, :2])).min(1)
    assert flight.position_stats["wall_distance"]["p50"] == pytest.approx(np.median(walls), abs=1e-4)


def test_a_flight_does_not_depend_on_those_before_it() -> None:
    same(small_recording(2, (5,)).flights[0], small_recording().flights[1])


def test_without_a_reward_its_own_is_kept_and_points_are_thinned() -> None:
    env = flying_env()
    try:
        flight = record_flight(env, StraightPolicy(3.5), 1, seed=SEED, max_points=50)
    finally:
        env.close()
    assert flight.reward_names == ("reward",)
    np.testing.assert_allclose(flight.rewards[:, 0], -np.diff(flight.distances), atol=1e-5)
    assert np.diff(flight.point_ends, prepend=0).max() == 50


def test_the_terms_that_are_kept_are_those_of_the_reward() -> None:
    flight = small_recording().flights[0]
    assert flight.reward_names == ("progress", "altitude", "heading", "elevation", "arrival", "collision")
    np.testing.assert_allclose(flight.rewards[:-1, 0], -8 * np.diff(flight.distances)[:-1], atol=1e-4)
    altitudes = flight.positions[1:, 2]
    np.testing.assert_allclose(flight.rewards[:-1, 1], 1 - np.abs(altitudes[:-1] - 3.5) / 3.5, atol=1e-5)


def test_more_than_one_vehicle_and_no_tasks_are_refused() -> None:
    env = flying_env(num_uavs=2)
    with pytest.raises(ValueError, match="num_uavs=1"):
        record_flight(env, StraightPolicy(3.5), 0, seed=0)
    with pytest.raises(ValueError, match="at least one task"):
        record_flights(env, StraightPolicy(3.5), [], seed=0, source={})
    env.close()


def test_thinning_keeps_few_points_and_all_where_there_are_few() -> None:
    points = np.arange(300.0).reshape(100, 3)
    few = thinned(points, 10)
    assert few.shape == (10, 3) and np.isin(few, points).all() and (np.diff(few[:, 0]) > 0).all()
    assert thinned(points, 100) is points


# ---------------------------------------------------------------------- the file


def test_the_file_gives_the_flights_back_without_pickles(tmp_path: Path) -> None:
    replay = small_recording()
    save_recording(replay, tmp_path / "flights.npz")
    loaded = load_recording(tmp_path / "flights.npz")
    assert loaded.source == replay.source
    for one, other in zip(loaded.flights, replay.flights, strict=True):
        same(one, other)
    for seed, scenery in replay.sceneries.items():
        same(loaded.sceneries[seed], scenery)
    assert [path.name for path in tmp_path.iterdir()] == ["flights.npz"]


def rewritten(path: Path, **summary: Any) -> None:
    """The first flight's summary in a file, with other values; None takes one out."""
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"]))
    kept = {**about["items"]["flight0"]["summary"], **summary}
    about["items"]["flight0"]["summary"] = {key: value for key, value in kept.items() if value is not None}
    np.savez(path, **{**arrays, "about": np.array(json.dumps(about))})


def test_a_file_from_before_smoothness_was_measured_is_read_and_a_damaged_measure_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flights.npz"
    save_recording(small_recording(), path)
    rewritten(path, action_change=None, yaw_reversals=None)
    summary = load_recording(path).flights[0].summary
    assert summary.action_change is summary.yaw_reversals is None
    for damage in ({"action_change": [1.0, 2.0, 3.0]}, {"action_change": ["<b>"] * 4}, {"yaw_reversals": "<b>"}):
        save_recording(small_recording(), path)
        rewritten(path, **damage)
        with pytest.raises(UavrlError, match="is damaged"):
            load_recording(path)


def archive(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no archive",
        archive(x=np.zeros(3)),
        archive(about=np.array('{"format": "other"}')),
        archive(about=np.array([{"a": 1}], dtype=object)),
    ],
    ids=["empty", "text", "other arrays", "other format", "pickle"],
)
def test_another_file_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "f.npz").write_bytes(content)
    with pytest.raises(UavrlError, match="contains no episodes, or is damaged"):
        load_recording(tmp_path / "f.npz")


@pytest.mark.parametrize("directions", [np.zeros((0, 3)), np.zeros((32, 2)), np.ones((8, 3)), np.full((32, 3), np.nan)])
def test_cells_without_directions_are_refused(directions: np.ndarray, tmp_path: Path) -> None:
    replay = small_recording()
    sceneries = {seed: replace(scenery, directions=directions) for seed, scenery in replay.sceneries.items()}
    save_recording(replace(replay, sceneries=sceneries), tmp_path / "f.npz")
    with pytest.raises(UavrlError, match="contains no episodes, or is damaged"):
        load_recording(tmp_path / "f.npz")


def test_a_missing_and_a_truncated_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match="found no such file"):
        load_recording(tmp_path / "none.npz")
    save_recording(small_recording(), tmp_path / "f.npz")
    data = (tmp_path / "f.npz").read_bytes()
    (tmp_path / "f.npz").write_bytes(data[: len(data) // 2])
    with zipfile.ZipFile(tmp_path / "g.npz", "w") as bad:
        bad.writestr("about.npy", b"broken")
    for name in ("f.npz", "g.npz"):
        with pytest.raises(UavrlError, match="damaged"):
            load_recording(tmp_path / name)
