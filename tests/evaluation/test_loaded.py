"""A trained policy in one line of Python, with an environment that goes with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tensordict import TensorDict
from torch.testing import assert_close

import uavrl
from tests.helpers.commands import VALLEY
from tests.helpers.recorded import recorded
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import PACKAGED
from uavrl.transforms import RangeImage, TruncatedIcosahedron


@pytest.mark.parametrize(
    "name", ["best", PACKAGED / "best"], ids=["by its name", "by a folder as uavrl-export writes it"]
)
def test_a_packaged_policy_acts_as_it_did(name: str | Path) -> None:
    policy, kept = uavrl.load_policy(name), recorded("best")
    states = TensorDict({"observation": kept["observation"]}, [len(kept["observation"])])
    acted = policy(states)
    assert_close(acted["action"], kept["action"], atol=1e-4, rtol=0)
    assert not acted["action"].requires_grad and any(each.requires_grad for each in policy.parameters())
    assert policy.source["run"] == str(PACKAGED / "best") and policy.source["training_steps"] > 0


def test_its_environment_has_what_it_reads_and_is_in_a_valley_of_its_own() -> None:
    env = uavrl.load_policy("best").make_env(*VALLEY, "randomize=none", "env.max_steps=7", num_uavs=2)
    steps = env.rollout(3, uavrl.load_policy("best"))
    assert steps["observation"].shape == (2, 3, 237) and steps["action"].shape == (2, 3, 4)
    assert {"reward", "arrived", "collided"} <= set(steps["next"].keys()), "what it was trained with"
    base = env.base_env
    assert base.world.config.seeds == (100,) and base.world.config.size == (14.0, 12.0) and base.max_steps == 7
    assert any(isinstance(part, RangeImage) for part in env.transform.modules())
    env.close()


def test_it_flies_the_tasks_that_are_asked_for() -> None:
    policy = uavrl.load_policy("best")
    every = policy.make_env(*VALLEY, "randomize=none", num_uavs=4)
    some = policy.make_env(*VALLEY, "randomize=none", num_uavs=2, tasks=[3, 1])
    assert_close(some.reset()["observation"], every.reset()["observation"][[3, 1]])
    with pytest.raises(UavrlError, match="tasks takes a list of one task or more"):
        policy.make_env(tasks=[])
    for env in (every, some):
        env.close()


def test_a_run_of_ones_own(run_dir: Path) -> None:
    policy = uavrl.load_policy(str(run_dir))
    env = policy.make_env(num_uavs=2, valleys=[3])
    assert env.rollout(2, policy)["action"].abs().max() <= 2
    assert env.base_env.world.config.seeds == (3,)
    assert any(isinstance(part, TruncatedIcosahedron) for part in env.transform.modules())
    env.close()
    by_seed = policy.make_env("env.world.seeds=[4]")
    assert by_seed.base_env.world.config.seeds == (4,)
    by_seed.close()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("bst", "policy must be one of best.* got 'bst': did you mean best?"),
        ("straight", "got 'straight': for your own give the folder of a run, or one that uavrl-export wrote"),
        ("no/where", "Expected a run folder at no/where"),
    ],
)
def test_an_unknown_policy_is_refused_in_a_sentence(name: str, said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        uavrl.load_policy(name)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("episodes=3", "make_env takes changes of env, .*, got 'episodes'"),
        ("env.num_uavs=3", "got 'env.num_uavs'"),
        ("perception.radius=3", "got 'perception.radius'"),
        ("env.world.sise=[1,1]", r"make_env cannot take env.world.sise=\[1,1\]. Could not override 'env.world.sise'"),
    ],
)
def test_a_change_that_it_cannot_bear_is_refused(change: str, said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        uavrl.load_policy("best").make_env(change)


def test_another_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'load_policies'"):
        uavrl.load_policies  # noqa: B018
