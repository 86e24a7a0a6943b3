"""The vectorised Gymnasium environment: one world, the episodes of single environments, and Gymnasium's autoresets."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.vector import DictInfoToList, NormalizeObservation, RecordEpisodeStatistics

from tests.helpers.valleys import NEAR, SMALL
from uavrl.envs.bullet import pybullet
from uavrl.envs.gym import ValleyEnv
from uavrl.envs.gym_vector import ValleyVectorEnv
from uavrl.errors import UavrlError

NAME = "uavrl:uavrl/Valley-v0"
VEHICLES, LIMIT = 3, 4
HOVER = np.zeros((VEHICLES, 4), dtype=np.float32)
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (11, VEHICLES, 4)).astype(np.float32)
Make = Callable[..., ValleyVectorEnv]


@pytest.fixture
def make() -> Iterator[Make]:
    made: list[ValleyVectorEnv] = []

    def build(mode: str = "NextStep", num_envs: int = VEHICLES, **kwargs: Any) -> ValleyVectorEnv:
        made.append(ValleyVectorEnv(num_envs, autoreset_mode=mode, **{"world": SMALL, "max_steps": LIMIT} | kwargs))
        return made[-1]

    yield build
    for envs in made:
        envs.close()


class InTurn(gymnasium.Wrapper):
    """A single environment that takes the next task of all of them at each reset, and their seed at the first."""

    def __init__(self, tasks: Iterator[int]) -> None:
        super().__init__(ValleyEnv(world=SMALL, max_steps=LIMIT))
        self._tasks, self._fresh = tasks, True

    def reset(self, **kwargs: Any) -> Any:
        seed, self._fresh = 3 if self._fresh else None, False
        return self.env.reset(seed=seed, options={"task": next(self._tasks)})


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_its_episodes_are_those_of_single_environments(make: Make, mode: AutoresetMode) -> None:
    """In all that Gymnasium's own vector of them returns: types, masks and what ends an episode included."""
    tasks = iter(range(100))
    singles: Any = SyncVectorEnv([lambda: InTurn(tasks)] * VEHICLES, autoreset_mode=mode)
    ours = make(mode.value)
    assert ours.metadata["autoreset_mode"] is mode
    require_alike(ours.reset(seed=3), singles.reset())
    for actions in ACTIONS:
        steps = [envs.step(actions) for envs in (ours, singles)]
        require_alike(*steps)
        ended = steps[0][2] | steps[0][3]
        if mode is AutoresetMode.DISABLED and ended.any():
            require_alike(*(envs.reset(options={"reset_mask": ended.copy()}) for envs in (ours, singles)))
    assert next(tasks) > 2 * VEHICLES, "episodes have ended"
    singles.close()


def require_alike(ours: Any, theirs: Any) -> None:
    """Requires equal keys, types and shapes, and numbers as near as batches of other sizes round."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        ours, theirs = ([values[key] for key in sorted(values)] for values in (ours, theirs))
    if isinstance(ours, list | tuple):
        for one, other in zip(ours, theirs, strict=True):
            require_alike(one, other)
    elif isinstance(ours, np.ndarray):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape)
        if ours.dtype == object:
            require_alike(list(ours), list(theirs))
        else:
            np.testing.assert_allclose(ours, theirs, atol=1e-3)
    else:
        assert ours is theirs is None


def test_make_vec_puts_all_vehicles_into_one_world() -> None:
    envs = gymnasium.make_vec(NAME, num_envs=VEHICLES, world=SMALL, lidar=NEAR, max_episode_steps=2)
    assert isinstance(envs, ValleyVectorEnv) and envs.num_envs == VEHICLES
    envs.reset(seed=0)
    base = envs._flights.base
    assert len(base.simulation._vehicles) == VEHICLES
    single = gymnasium.make(NAME, world=SMALL)
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space == batch_space(single.observation_space, VEHICLES)
    assert envs.action_space == batch_space(single.action_space, VEHICLES)
    assert [envs.step(HOVER)[3].tolist() for _ in range(2)] == [[False] * VEHICLES, [True] * VEHICLES]
    envs.close()
    single.close()


@pytest.mark.parametrize("given", ["SameStep", AutoresetMode.SAME_STEP])
def test_its_specification_survives_json_pickle_and_deepcopy(given: AutoresetMode | str) -> None:
    envs = gymnasium.make_vec(NAME, num_envs=2, world=SMALL, autoreset_mode=given, max_steps=9)
    spec = envs.spec
    assert spec is not None
    for kept in (EnvSpec.from_json(spec.to_json()), pickle.loads(pickle.dumps(spec)), copy.deepcopy(spec)):
        again = gymnasium.make_vec(kept)
        assert isinstance(again, ValleyVectorEnv) and again.num_envs == 2
        assert again.autoreset_mode is AutoresetMode.SAME_STEP
        assert (again._flights.base.world_config, again._flights.base.max_steps) == (SMALL, 9)
        again.close()
    envs.close()


def test_a_seed_repeats_bit_identically_and_options_choose_the_task(make: Make) -> None:
    envs, seen = make(), []
    for seed in (7, 7, 8):
        start, _ = envs.reset(seed=seed)
        seen.append(np.concatenate([start, *(envs.step(actions)[0] for actions in ACTIONS)]))
    np.testing.assert_array_equal(seen[0], seen[1])
    assert (seen[1] != seen[2]).any()
    goals = envs.reset(seed=7)[1]["goal"]
    np.testing.assert_array_equal(envs.reset(options={"task": 1})[1]["goal"][:2], goals[1:])
    other = make()
    assert (other.reset()[1]["goal"] != make().reset()[1]["goal"]).any(), "without a seed a random one"


def test_an_ended_vehicle_waits_for_its_reset_whatever_its_action_is(make: Make) -> None:
    envs = make()
    envs.reset(seed=0)
    for _ in range(LIMIT):
        *_, truncated, _ = envs.step(HOVER)
    assert truncated.all()
    observations, rewards, terminated, truncated, infos = envs.step(np.full((VEHICLES, 4), np.nan, dtype=np.float32))
    assert not (rewards.any() or terminated.any() or truncated.any())
    assert not observations[:, :70].any() and np.isfinite(observations).all(), "a first frame"
    assert "final_obs" not in infos


def test_a_mask_resets_some_vehicles_and_leaves_the_others_where_they_are(make: Make) -> None:
    envs = make("Disabled", max_steps=100)
    envs.reset(seed=0)
    before, *_, infos = envs.step(ACTIONS[0])
    mask = np.array([False, True, False])
    after, told = envs.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[~mask], before[~mask])
    assert (told["goal"][1] != infos["goal"][1]).any()
    assert not told["goal"][~mask].any() and told["_goal"].tolist() == mask.tolist()
    position = envs._flights.infos()["position"]
    np.testing.assert_array_equal(position[~mask], infos["position"][~mask])


def test_without_autoreset_an_ended_vehicle_has_to_be_reset(make: Make) -> None:
    envs = make("Disabled", max_steps=1)
    envs.reset(seed=0)
    envs.step(HOVER)
    envs.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(
        UavrlError, match=r"episodes of vehicles \[1\] have ended, and autoreset is disabled: call reset"
    ):
        envs.step(HOVER)
    envs.reset()
    envs.step(HOVER)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda make: make("Never"), "autoreset_mode must be one of NextStep, SameStep, Disabled, got 'Never'"),
        (lambda make: make(num_envs=0), "num_envs must be a whole number, 1 or more, got 0"),
        (lambda make: make(render_mode="human"), "render_mode must be rgb_array or None, got 'human'"),
        (lambda make: make(world={"plane": 1}), "world has no setting 'plane': did you mean planes?"),
        (lambda make: make().step(HOVER), "Reset the environment before the first step"),
        (lambda make: make().reset(seed=[1, 2, 3]), r"seed must be a whole number, 0 or more, got \[1, 2, 3\]"),
        (lambda make: make().reset(options={"tsk": 1}), "options takes task, the number of a task, got 'tsk'"),
        (lambda make: make().step(HOVER[:2]), r"Expected actions of shape \(3, 4\), one row .* got \(2, 4\)"),
        *(
            (
                lambda make, mask=mask: make().reset(options={"reset_mask": mask}),
                "a NumPy array of 3 bools, at least one",
            )
            for mask in ([True, False, True], np.ones(2, dtype=bool), np.ones(3), np.zeros(3, dtype=bool))
        ),
    ],
)
def test_what_it_cannot_do_is_refused_in_a_sentence(make: Make, call: Callable[[Make], Any], said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        call(make)


def test_it_draws_each_vehicle_and_is_freed(make: Make) -> None:
    envs = make(render_mode="rgb_array")
    with pytest.raises(UavrlError, match="before the first picture"):
        envs.render()
    envs.reset(seed=0)
    pictures = envs.render()
    assert pictures is not None and [picture.shape for picture in pictures] == [(360, 480, 3)] * VEHICLES
    single = ValleyEnv(world=SMALL, render_mode="rgb_array")
    single.reset(seed=0, options={"task": 1})
    drawn = single.render()
    assert drawn is not None and (pictures[1] != drawn).mean() < 0.01 < (pictures[0] != drawn).mean()
    single.close()
    client = envs._flights.base.simulation._client
    for _ in range(2):
        envs.close()
    assert envs.closed and not pybullet.getConnectionInfo(physicsClientId=client)["isConnected"]
    with pytest.raises(UavrlError, match="closed and has freed its simulation"):
        envs.step(HOVER)
    assert make().render() is None, "without a render mode"


def test_gymnasiums_wrappers_take_it(make: Make) -> None:
    envs: Any = DictInfoToList(RecordEpisodeStatistics(NormalizeObservation(make())))
    envs.reset(seed=0)
    for _ in range(LIMIT):
        observations, *_, infos = envs.step(HOVER)
    assert observations.shape == (VEHICLES, 105) and len(infos) == VEHICLES
    assert [info["episode"]["l"] for info in infos] == [LIMIT] * VEHICLES
