"""A flight is kept as it was flown: its numbers are the environment's, and its file gives them back."""

from __future__ import annotations

import io
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from tests.training.flights import PERCEPTION, REWARD, SEED, STEPS, small_env, small_replay
from uavrl.errors import UavrlError
from uavrl.training.baselines import StraightPolicy
from uavrl.training.evaluation import fly
from uavrl.training.factory import make_env
from uavrl.training.flight import load_replay, save_replay, thinned
from uavrl.training.replay import record_flight, record_flights
from uavrl.transforms import NavigationReward, TraditionalReward
from uavrl.transforms.functional import truncated_icosahedron


def same(a: Any, b: Any) -> None:
    for field in fields(a):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other, err_msg=field.name)
            assert one.dtype == other.dtype
        else:
            assert one == other, field.name


def test_every_moment_is_kept() -> None:
    for flight, task in zip(small_replay().flights, (0, 5), strict=True):
        steps, moments = flight.summary.steps, flight.summary.steps + 1
        assert flight.summary.task == task and 1 <= steps <= STEPS
        shapes = {
            "times": (moments,),
            "positions": (moments, 3),
            "attitudes": (moments, 4),
            "velocities": (moments, 3),
            "goal": (3,),
            "observations": (moments, 105),
            "actions": (steps, 4),
            "rewards": (steps, 6),
            "distances": (moments,),
            "clearances": (moments,),
            "risks": (0,),
            "planes": (moments, 2, 4),
            "faces": (moments, 32),
            "point_ends": (moments,),
        }
        assert {name: getattr(flight, name).shape for name in shapes} == shapes
        assert flight.point_ends[-1] == len(flight.points)
        np.testing.assert_allclose(np.diff(flight.times), 0.1)


def test_positions_are_the_valleys_own_and_agree_with_distances_and_velocities() -> None:
    replay = small_replay()
    assert {f.summary.world_seed for f in replay.flights} == set(replay.sceneries)
    for flight in replay.flights:
        assert (np.abs(flight.positions[:, :2]) < replay.scenery(flight).size / 2).all()
        np.testing.assert_allclose(np.linalg.norm(flight.positions - flight.goal, axis=1), flight.distances, atol=1e-4)
        mean = (flight.velocities[1:] + flight.velocities[:-1]) / 2
        np.testing.assert_allclose(np.diff(flight.positions, axis=0) / 0.1, mean, atol=0.15)
        flown = np.linalg.norm(np.diff(flight.positions, axis=0), axis=1).sum()
        assert flown == pytest.approx(flight.summary.flown, rel=1e-4)


def test_the_cloud_that_is_kept_gives_the_faces_that_are_kept() -> None:
    flight = small_replay().flights[0]
    for moment in (0, 3, flight.summary.steps):
        cloud = torch.from_numpy(flight.cloud(moment))
        torch.testing.assert_close(truncated_icosahedron(cloud), torch.from_numpy(flight.faces[moment]))
        assert len(cloud)


def test_points_lie_on_the_ground_or_above_it() -> None:
    replay = small_replay()
    flight = replay.flights[0]
    scenery = replay.scenery(flight)
    turn = Rotation.from_quat(flight.attitudes[4])
    points = turn.apply(flight.cloud(4) + scenery.sensor) + flight.positions[4]
    assert points[:, 2].min() > scenery.heights.min() - 0.01
    corners = scenery.vertices[np.abs(scenery.vertices[:, :2] - flight.positions[4, :2]).max(1) < 6]
    assert len(corners) or (np.abs(points[:, 2]) < 8).all()


def test_planes_fly_between_the_moments() -> None:
    for flight in small_replay().flights:
        moved = np.linalg.norm(np.diff(flight.planes[..., :2], axis=0), axis=-1) / 0.1
        assert ((moved > 2.4) & (moved < 4.1)).mean() > 0.9  # but where one enters anew


def test_a_flight_is_that_of_the_evaluation() -> None:
    tasks = (0, 1, 2)
    env = make_env(small_env(), PERCEPTION, seed=SEED, num_uavs=2, measure_clearance=True)
    try:
        evaluated = fly(env, StraightPolicy(3.5), len(tasks))
    finally:
        env.close()
    kept = [flight.summary for flight in small_replay(0, tasks).flights]
    for one, other in zip(kept, evaluated, strict=True):
        assert (one.task, one.world_seed, one.outcome, one.steps) == (
            other.task,
            other.world_seed,
            other.outcome,
            other.steps,
        )
        assert one.flown == pytest.approx(other.flown, abs=1e-4)
        assert one.clearance == pytest.approx(other.clearance, abs=1e-3)


def test_a_flight_tells_where_it_went() -> None:
    flight = small_replay().flights[0]
    altitudes = flight.positions[1:, 2].astype(float)
    half = np.array(small_env().world.size) / 2
    assert flight.whereabouts["steps"] == flight.summary.steps
    assert flight.whereabouts["altitude"]["p50"] == pytest.approx(np.median(altitudes))
    walls = (half - np.abs(flight.positions[1:, :2])).min(1)
    assert flight.whereabouts["wall_distance"]["p50"] == pytest.approx(np.median(walls), abs=1e-4)


def test_a_flight_does_not_depend_on_those_before_it() -> None:
    source = small_replay().source
    alone = record_flights(
        small_env(2), PERCEPTION, StraightPolicy(3.5), [5], seed=SEED, source=source, reward=REWARD,
        max_points=100_000,
    )  # fmt: skip
    same(alone.flights[0], small_replay().flights[1])


def test_without_a_reward_its_own_is_kept_and_points_are_thinned() -> None:
    env = make_env(small_env(), PERCEPTION, seed=0, num_uavs=1, measure_clearance=True, keep_cloud=True)
    try:
        flight = record_flight(env, StraightPolicy(3.5), 1, seed=SEED, max_points=50)
    finally:
        env.close()
    assert flight.reward_names == ("reward",)
    np.testing.assert_allclose(flight.rewards[:, 0], -np.diff(flight.distances), atol=1e-5)
    assert np.diff(flight.point_ends, prepend=0).max() == 50


def test_more_than_one_vehicle_and_no_tasks_are_refused() -> None:
    env = make_env(small_env(), PERCEPTION, num_uavs=2, measure_clearance=True, keep_cloud=True)
    with pytest.raises(ValueError, match="num_uavs=1"):
        record_flight(env, StraightPolicy(3.5), 0, seed=0)
    with pytest.raises(ValueError, match="at least one task"):
        record_flights(small_env(), PERCEPTION, StraightPolicy(3.5), [], seed=0, source={})


@pytest.mark.parametrize(
    "reward",
    [
        NavigationReward(arrived_reward=200.0),
        NavigationReward((3.0, 2.0, 1.0, 0.5), altitude_term="literal", collided_reward=-10.0),
        TraditionalReward(),
    ],
    ids=["prize", "literal", "traditional"],
)
def test_the_terms_add_up_to_the_reward(reward: NavigationReward | TraditionalReward) -> None:
    generator = torch.Generator().manual_seed(0)
    shape, draw = (200, 1), lambda: torch.rand(200, 1, generator=generator)
    ended = draw()
    after = TensorDict(
        {
            "distance": 20 * draw(),
            "altitude": 8 * draw(),
            "heading_deg": 360 * draw(),
            "elevation_deg": 360 * draw(),
            "arrived": ended < 0.4,
            "collided": ended > 0.3,  # a tenth does both
        },
        shape[:1],
    )
    steps = TensorDict({"distance": 20 * draw(), "next": after}, shape[:1])
    terms = reward.terms(steps, after)
    assert all(term.shape == (200,) for term in terms.values())
    expected = reward(steps)["next", "reward"][:, 0]
    torch.testing.assert_close(torch.stack(list(terms.values())).sum(0), expected)


def test_thinning_keeps_few_points_and_all_where_there_are_few() -> None:
    points = np.arange(300.0).reshape(100, 3)
    few = thinned(points, 10)
    assert few.shape == (10, 3) and np.isin(few, points).all() and (np.diff(few[:, 0]) > 0).all()
    assert thinned(points, 100) is points


# ---------------------------------------------------------------------- the file


def test_the_file_gives_the_flights_back_without_pickles(tmp_path: Path) -> None:
    replay = small_replay()
    save_replay(replay, tmp_path / "flights.npz")
    loaded = load_replay(tmp_path / "flights.npz")
    assert loaded.source == replay.source
    for one, other in zip(loaded.flights, replay.flights, strict=True):
        same(one, other)
    for seed, scenery in replay.sceneries.items():
        same(loaded.sceneries[seed], scenery)
    assert [path.name for path in tmp_path.iterdir()] == ["flights.npz"]


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
    with pytest.raises(UavrlError, match="holds no flights, or is damaged"):
        load_replay(tmp_path / "f.npz")


def test_a_missing_and_a_truncated_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match="found no such file"):
        load_replay(tmp_path / "none.npz")
    save_replay(small_replay(), tmp_path / "f.npz")
    data = (tmp_path / "f.npz").read_bytes()
    (tmp_path / "f.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(UavrlError, match="damaged"):
        load_replay(tmp_path / "f.npz")
    with zipfile.ZipFile(tmp_path / "g.npz", "w") as bad:
        bad.writestr("about.npy", b"broken")
    with pytest.raises(UavrlError, match="damaged"):
        load_replay(tmp_path / "g.npz")
