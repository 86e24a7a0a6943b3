"""What a policy may be kept from seeing: everything, or the planes alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.envs import check_env_specs

from tests.helpers.configs import composed
from uavrl.config import validate
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.world import WorldConfig
from uavrl.evaluation.environment import make_env

STAY = torch.zeros(1, 4)
FACES = 32
SMALL: dict[str, Any] = {"size": (26.0, 20.0), "obstacles": 8}  # which is built quickly


@pytest.fixture
def make() -> Iterator[Callable[..., NavigationEnv]]:
    made: list[NavigationEnv] = []

    def build(**kwargs: Any) -> NavigationEnv:
        made.append(NavigationEnv(1, lidar=LidarConfig(max_range=20.0), **kwargs))
        made[-1].reset()
        return made[-1]

    yield build
    for env in made:
        env.close(raise_if_closed=False)


def place(env: NavigationEnv, position: np.ndarray, yaw: float = 0.0) -> None:
    env.simulation.reset(np.array([0]), position[None], np.array([yaw]))


def scan(env: NavigationEnv) -> np.ndarray:
    return env._scan(np.array([0]))[0]


def test_a_blind_policy_reads_nothing_near_just_over_the_ground_and_the_same_altitude_and_angles() -> None:
    small = ["env.num_uavs=1", "env.world.size=[26,20]", "env.world.obstacles=8"]
    settings = [validate(composed("config", *small, f"perception.blind={blind}")) for blind in (False, True)]
    seeing, blind = (make_env(one.env, one.perception, seed=3) for one in settings)
    resets = [env.reset() for env in (seeing, blind)]
    states = []
    for env, state in zip((seeing, blind), resets, strict=True):
        place(env.base_env, np.array([0.0, 0.0, 1.2]), yaw=0.5)
        states.append(env.step(state.set("action", STAY))["next"])
    frames = [state["observation"][0].unflatten(0, (3, -1))[-1] for state in states]
    assert frames[0][:FACES].max() > 0.1
    assert not frames[1][:FACES].any() and not states[1]["faces"].any()
    torch.testing.assert_close(frames[0][FACES:], frames[1][FACES:], rtol=0, atol=0)
    for env in (seeing, blind):
        env.close()


def test_a_blind_environment_casts_nothing(make: Callable[..., NavigationEnv]) -> None:
    env = make(world=WorldConfig(**SMALL), blind=True)
    assert env._lidar is None
    check_env_specs(env)
    state = env.reset()
    for _ in range(2):
        state = env.step(state.set("action", STAY))["next"]
        assert state["point_cloud"].shape == (1, 28928, 3) and state["point_cloud"].isnan().all()
    kept = state["point_cloud"]
    after = env.step(state.set("action", STAY))["next", "point_cloud"]
    assert after.data_ptr() == kept.data_ptr(), "nothing is filled anew"


def test_partial_resets_of_the_blind_leave_the_others_as_they_were() -> None:
    env = NavigationEnv(3, blind=True, max_steps=3)
    state, rows = env.reset(), []
    place_at = np.array([0.0, 0.0, 30.0])
    env.simulation.reset(np.array([1]), place_at[None], np.zeros(1))
    for _ in range(4):
        stepped, state = env.step_and_maybe_reset(state.set("action", torch.zeros(3, 4)))
        rows.append(stepped["next", "done"].flatten().tolist())
        assert state["point_cloud"].isnan().all() and state["position"].isfinite().all()
    assert rows[0] == [False, True, False] and rows[2][0] and rows[2][2]
    env.close()


def ahead_of_a_plane(env: NavigationEnv, distance: float = 2.0) -> tuple[np.ndarray, float]:
    """A place so many metres ahead of a plane over the middle of the valley, and the yaw that looks at it."""
    while np.linalg.norm(env.plane_poses()[0, :2]) > 7.0:
        env.step(env.reset().set("action", STAY))
    x, y, z, yaw = env.plane_poses()[0]
    return np.array([x + distance * np.cos(yaw), y + distance * np.sin(yaw), z]), yaw + np.pi


def test_hidden_planes_are_not_seen_and_the_rest_of_the_scan_is(make: Callable[..., NavigationEnv]) -> None:
    seeing, hidden = (make(world=WorldConfig(planes=1, **SMALL), blind_to=name) for name in (None, "planes"))
    clear = make(world=WorldConfig(planes=0, **SMALL))
    (position, yaw), _ = (ahead_of_a_plane(env) for env in (seeing, hidden))
    np.testing.assert_array_equal(seeing.plane_poses(), hidden.plane_poses())
    clouds = []
    for env in (seeing, hidden, clear):
        place(env, position, yaw)
        clouds.append(scan(env))
    np.testing.assert_array_equal(clouds[1], clouds[2])
    changed = ~np.isclose(clouds[0], clouds[1], equal_nan=True).all(-1)
    assert changed.sum() > 100
    assert (np.linalg.norm(clouds[0][changed], axis=-1) < 4.0).all()
    assert (clouds[0][changed, 0] > 0).mean() == 1.0, "the plane is ahead"


def test_hidden_planes_collide(make: Callable[..., NavigationEnv]) -> None:
    env = make(world=WorldConfig(planes=1, size=SMALL["size"], obstacles=0), blind_to="planes")
    state = env.reset()
    nose, hull = env.traffic.mesh.vertices[:, 0].max(), env.airframe.collision_radius
    place(env, *ahead_of_a_plane(env, nose + hull + 0.1))
    assert 0.0 < env.simulation.closest_distance()[0] < 0.2, "the plane comes, and touches nothing yet"
    for _ in range(3):
        state = env.step(state.set("action", STAY))["next"]
        if state["collided"].item():
            break
    assert state["collided"].item()
    gap = np.linalg.norm(env.plane_poses()[0, :3] - env.simulation.position[0])
    assert gap < nose + hull, "it is the plane that was hit: there is nothing else in the air"


def test_an_unknown_thing_to_hide_is_refused() -> None:
    with pytest.raises(ValueError, match="blind_to must be None or 'planes', got 'rocks'"):
        NavigationEnv(1, blind_to="rocks")  # type: ignore[arg-type]
