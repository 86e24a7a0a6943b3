"""Any policy is kept out of the ways of what moves, and flies as it asks where nothing does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch.testing import assert_close

from tests.helpers.commands import in_process
from uavrl import load_policy
from uavrl.cli import evaluate
from uavrl.config import compose, validate
from uavrl.config.settings import EvaluateConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import with_sight
from uavrl.evaluation.guarded import GuardedPolicy
from uavrl.evaluation.policies import PACKAGED, choose
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import body_to_level, body_to_world
from uavrl_onboard.guards.evade import evaded
from uavrl_onboard.guards.evasion import Evasion
from uavrl_onboard.guards.shield import Shield
from uavrl_onboard.perception.motion.threats import HIGH, STEPS, WIDE
from uavrl_onboard.vehicle import Vehicle

ABOVE = 0.1  # m, of the LiDAR over the hull's middle
PERIOD = 0.1
LEVEL = 3.5


def ball(place: np.ndarray, radius: float = 0.3) -> np.ndarray:
    """Points ``[225, 3]`` on a ball, as close as a VLP-16's lasers are 6 m away."""
    across, up = np.meshgrid(np.linspace(0, 2 * np.pi, 15, endpoint=False), np.linspace(-1.4, 1.4, 15))
    shape = np.stack([np.cos(across) * np.cos(up), np.sin(across) * np.cos(up), np.sin(up)], -1)
    return place + radius * shape.reshape(-1, 3)


class Ahead:
    """Asks for full speed ahead, and hears what is flown."""

    in_keys = ("is_init",)

    def __init__(self) -> None:
        self.heard = list[list[float]]()

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", torch.tensor([2.0, 0.0, 0.0, 0.5]).expand(*tensordict.batch_size, 4).clone())

    def flown(self, actions: np.ndarray) -> None:
        self.heard.extend(actions.tolist())


def flight(policy: GuardedPolicy | Ahead, begin: list[float], speed: list[float]) -> float:
    """How near a ball comes that flies straight on, while the policy flies; 1 keeps the margin, 0.66 touches."""
    place, velocity, nearest = np.zeros(3), np.array([2.0, 0.0, 0.0]), np.inf
    for step in range(40):
        apart = np.array(begin) + PERIOD * step * np.array(speed) - place
        nearest = min(nearest, max(np.hypot(*apart[:2]) / WIDE, abs(apart[2]) / HIGH))
        state = {
            "point_cloud": torch.from_numpy(ball(apart) - [0.0, 0.0, ABOVE]).float()[None],
            "is_init": torch.tensor([[step == 0]]),
            "altitude": torch.tensor([[LEVEL + place[2]]]).float(),
            "velocity": torch.from_numpy(velocity).float()[None],
            "attitude": torch.zeros(1, 3),
        }
        velocity = velocity + 0.22 * (policy(TensorDict(state, [1]))["action"][0, :3].double().numpy() - velocity)
        place = place + PERIOD * velocity
    return float(nearest)


@pytest.mark.parametrize(
    ("begin", "speed"),
    [([8.0, 0.2, 0.0], [-3.0, 0.0, 0.0]), ([4.0, 6.0, 0.0], [0.0, -3.0, 0.0]), ([4.0, -6.0, 0.2], [0.0, 3.0, 0.0])],
    ids=["ahead", "left", "right"],
)
def test_a_policy_that_knows_of_nothing_keeps_out_of_the_way_of_what_its_scans_show_to_move(
    begin: list[float], speed: list[float]
) -> None:
    assert flight(Ahead(), begin, speed) < 0.6
    assert flight(GuardedPolicy(Ahead(), evade=12.0), begin, speed) > 0.9


def evasive(aside: float, standing: np.ndarray, tilt: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """What is flown instead of 2 m/s ahead by a vehicle that stands, when a ball comes, a little ``aside``."""
    evasion, attitude = Evasion(), np.array([[*tilt, 0.0]])
    for step in range(14):
        points = np.concatenate([ball(np.array([8.0 - 0.3 * step, aside, 0.0])), standing])
        cloud = points @ body_to_world(attitude)[0] - [0.0, 0.0, ABOVE]
        flown = evasion(np.array([[2.0, 0.0, 0.0]]), cloud[None], np.zeros((1, 3)), attitude, np.zeros(1))[0]
    return np.asarray(flown)


def wall(side: float) -> np.ndarray:
    """Points all along the vehicle, 0.9 m from its middle, to the left or to the right."""
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-1.0, 4.0, 0.1), np.arange(-1.5, 1.6, 0.1)))
    return np.stack([x, np.full(len(x), 0.9 * side), z], -1)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, -0.1)], ids=["level", "tilted"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_gives_way_to_the_side_on_which_its_scan_shows_nothing(side: float, tilt: tuple[float, float]) -> None:
    """The ball comes a little to the free side, to which it gives way for the wall alone."""
    free, beside = (evasive(-0.3 * side, each, tilt) for each in (wall(side)[:0], wall(side)))
    assert side * free[1] > 0.3, "away from the ball"
    assert side * beside[1] <= 0, "not into the wall"


def test_what_stands_is_reckoned_from_the_hulls_middle_in_level_axes_without_the_vehicles_own_parts() -> None:
    """Rolled by 90 degrees the LiDAR is 0.5 m to the right, and what it sees above it lies to the right, too."""
    rolled = body_to_level(np.array([[np.pi / 2, 0.0, 2.0]]))[0]
    rotor, above = [0.2, 0.2, -0.45], [1.0, 0.0, 1.5]
    found = Evasion(vehicle=Vehicle(lidar_position=(0.0, 0.0, 0.5)))._around(np.array([rotor, above]), rolled)
    assert found[0] == pytest.approx(np.array([[1.0, -2.0, 0.0]]), abs=1e-6)


def test_what_passes_over_the_hull_is_let_pass_however_near_to_the_lidar() -> None:
    high, still, asked = (
        Evasion(vehicle=Vehicle(lidar_position=(0.0, 0.0, 0.5))),
        np.zeros((1, 3)),
        np.array([[2.0, 0.0, 0.0]]),
    )
    for step in range(14):
        cloud = ball(np.array([8.0 - 0.3 * step, 0.0, 0.4]), radius=0.1)[None]  # 0.9 m over the hull's middle
        assert high(asked, cloud, still, still, np.zeros(1)).tolist() == asked.tolist()


def test_what_stands_is_left_to_the_policy() -> None:
    policy = Ahead()
    flight(GuardedPolicy(policy, evade=12.0), [6.0, 0.1, 0.0], [0.0, 0.0, 0.0])
    assert policy.heard == [[2.0, 0.0, 0.0, 0.5]] * 40


def test_a_vehicle_whose_episode_begins_has_seen_nothing_yet() -> None:
    """Two see the same ball; the second one's episode begins with each scan, so that it never sees it move."""
    policy = GuardedPolicy(Ahead(), evade=12.0)
    for step in range(12):
        cloud = torch.from_numpy(ball(np.array([7.0 - 0.3 * step, 0.0, 0.0]))).float().expand(2, -1, -1)
        begins = torch.tensor([[step == 0], [True]])
        seen = {"velocity": torch.zeros(2, 3), "attitude": torch.zeros(2, 3), "altitude": torch.full((2, 1), LEVEL)}
        flown = policy(TensorDict({"point_cloud": cloud, "is_init": begins, **seen}, [2]))["action"]
    assert (flown[0, :3] - torch.tensor([2.0, 0.0, 0.0])).norm() > 0.5
    assert flown[1].tolist() == [2.0, 0.0, 0.0, 0.5]


@pytest.mark.parametrize("batch", [[], [3], [2, 5], [0]])
def test_any_batch_flies_with_it(batch: list[int]) -> None:
    ahead = TensorDictModule(lambda cells: cells + torch.tensor([3.0, 0.0, 0.0, 1.0]), ["cells"], ["action"])
    seen = TensorDict(cells=torch.zeros(*batch, 4), point_cloud=torch.ones(*batch, 6, 3), batch_size=batch)
    seen["attitude"], seen["velocity"] = torch.zeros(*batch, 3), torch.zeros(*batch, 3)
    seen["altitude"], seen["is_init"] = torch.full((*batch, 1), LEVEL), torch.ones(*batch, 1, dtype=torch.bool)
    assert_close(GuardedPolicy(ahead, evade=12.0)(seen)["action"], torch.tensor([2.0, 0.0, 0.0, 1.0]).expand(*batch, 4))


def test_tensors_are_evaded_as_arrays_are() -> None:
    begins, speed = np.array([[4.0, 0.3, 0.0], [5.0, -4.0, 0.1], [9.0, 9.0, 0.0]]), np.array([-3.0, 1.0, 0.0])
    ways = begins[:, None, None] + PERIOD * np.arange(1, STEPS + 1)[:, None] * speed
    planned, known = np.array([[2.0, 0.0, 0.0]] * 3), np.ones((3, 1), bool)
    points, heights = [ball(np.array([1.5, 0.9, 0.0]))] * 3, np.array([[0.0], [0.6], [0.0]])
    arrays = evaded(planned, planned, ways, known, points, heights)
    told = [torch.from_numpy(each) for each in (planned, planned, ways, known)]
    found = call_numpy(evaded, *told, [torch.from_numpy(each) for each in points], torch.from_numpy(heights))
    assert found.tolist() == arrays.tolist()
    assert np.abs(arrays[0] - planned[0]).max() > 0.5 and (arrays[2] == planned[2]).all()


def test_what_is_asked_for_counts_as_far_as_it_may_be_flown() -> None:
    """At 2 m/s the vehicle would be past before the ball comes; at 1 m/s, which it may fly, both meet."""
    quick, slow, still = Evasion(), Evasion(vehicle=Vehicle(velocity_limit=1.0)), np.zeros((1, 3))
    for step in range(10):
        scan = ball(np.array([0.4, 7.5 - 0.3 * step, 0.0]))[None], still, still, np.zeros(1)
        free, bent = (evasion(np.array([[2.0, 0.0, 0.0]]), *scan)[0].tolist() for evasion in (quick, slow))
    assert free == [2.0, 0.0, 0.0]
    assert bent not in ([2.0, 0.0, 0.0], [1.0, 0.0, 0.0])


def test_where_less_may_be_flown_it_evades_more_slowly() -> None:
    slow, still, most = Evasion(vehicle=Vehicle(velocity_limit=1.0)), np.zeros((1, 3)), 0.0
    for step in range(12):
        cloud = ball(np.array([9.0 - 0.3 * step, 0.5, 0.0]))[None]
        flown = slow(np.array([[1.0, 0.0, 0.0]]), cloud, still, still, np.zeros(1))
        most = max(most, float(np.linalg.norm(flown[0, 1:])))
        assert np.linalg.norm(flown) <= 1.0 + 1e-6
    assert most > 0.4


@pytest.mark.parametrize("elapsed", [0.0, -0.1, np.nan, np.inf])
def test_time_that_does_not_go_on_is_refused(elapsed: float) -> None:
    still = np.zeros((1, 3))
    with pytest.raises(UavrlError, match="elapsed must be a finite time above 0 s"):
        Evasion()(still, np.zeros((1, 4, 3)), still, still, np.zeros(1), elapsed)


@pytest.mark.parametrize("place", [0, 2, 3, 4])
def test_numbers_that_are_none_are_refused(place: int) -> None:
    told = [np.zeros((1, 3)), np.zeros((1, 4, 3)), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1)]
    told[place] = told[place] + np.nan
    with pytest.raises(UavrlError, match="finite numbers"):
        Evasion()(*told)


def test_behind_a_shield_the_policy_hears_what_is_flown_in_the_end() -> None:
    policy = Ahead()
    seen = TensorDict(point_cloud=torch.tensor([[[0.82 + 0.35, 0.0, -0.1]]]), batch_size=[1])
    seen["attitude"] = seen["velocity"] = torch.zeros(1, 3)
    seen["altitude"], seen["is_init"] = torch.full((1, 1), LEVEL), torch.ones(1, 1, dtype=torch.bool)
    GuardedPolicy(policy, evade=12.0, shield=Shield())(seen)
    assert policy.heard[-1] == [pytest.approx(each, abs=1e-6) for each in (1.0, 0.0, 0.0, 0.5)]


def test_an_evaluation_looks_as_far_and_knows_the_vehicles_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, reached = set[tuple[object, ...]](), list[float]()

    def stands(evasion: Evasion, asked: np.ndarray, clouds: np.ndarray, *_: object) -> np.ndarray:
        made.add((evasion.vehicles, evasion.max_range, evasion.vehicle.hull, evasion.vehicle.lidar_above))
        reached.append(float(np.linalg.norm(np.nan_to_num(clouds, posinf=0.0), axis=-1).max()))
        return np.zeros_like(asked)

    monkeypatch.setattr(Evasion, "__call__", stands)
    output = tmp_path / "evading.json"
    command = ["policy=straight", "evade=9", "episodes=2", "num_uavs=2", "env.max_steps=3", "progress=false"]
    assert in_process(evaluate.main, *command, "env.airframe.collision_radius=0.3", f"output={output}") == 0
    result = json.loads(output.read_text())
    assert "evade=9" in result["overrides"] and result["outcomes"] == "TT"
    assert max(flight["flown"] for flight in result["flights"]) < 0.2
    assert made == {(2, 9.0, (0.3, 0.14), 0.1)}
    assert 4.0 < max(reached) <= 9.0


def test_a_sensor_that_does_not_reach_as_far_is_refused() -> None:
    seen = validate(compose("perception.lidar.far_range=8")).perception
    assert with_sight(seen, evade=8.0) == seen
    with pytest.raises(
        UavrlError, match=r"evade=12 looks farther than the LiDAR, which reaches 8 m: .* or lower evade"
    ):
        with_sight(seen, evade=12.0)


@pytest.mark.parametrize(("evade", "more", "reaches"), [(15, [], 15.0), (8, [], 12.0), (9, ["far_range=20"], 20.0)])
def test_a_policy_that_was_trained_to_look_less_far_looks_as_far_as_is_asked(
    evade: float, more: list[str], reaches: float
) -> None:
    overrides = ["policy=best_dynamic", f"evade={evade}", *(f"perception.lidar.{each}" for each in more)]
    config = compose(*overrides, name="evaluate")
    folder = PACKAGED / "best_dynamic"
    chosen = choose(validate(config, EvaluateConfig), config, overrides, folder, torch.device("cpu"))
    assert chosen.perception["lidar"].far_range == reaches
    assert isinstance(chosen.policy, GuardedPolicy) and chosen.policy.evade == evade


def test_a_packaged_policys_environment_gives_what_it_reads() -> None:
    policy = load_policy("best")
    env = policy.make_env("perception.lidar.far_range=12", "randomize=none", "env.max_steps=2", keep_cloud=True)
    assert len(rollout_episodes(env, GuardedPolicy(policy, evade=12.0), 1)) == 1
