"""A host program whose default type is float64: policies, planners, guards and transforms keep float32."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, InitTracker, TransformedEnv, check_env_specs

from tests.helpers.losses import td3
from uavrl import load_policy
from uavrl.buffers import ABR, ABRPlus
from uavrl.config.build import find_class
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import BASELINES
from uavrl.models import (
    PSAE,
    Actor,
    Critic,
    GaussianActor,
    OneShotClassifier,
    RewardNet,
    SystemNet,
    TrajectoryClassifier,
)
from uavrl.transforms import Guarded, Mirror, NavigationReward, NavigationState, PointCloudReduction


@pytest.fixture
def doubles() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def small(*privileged: str, **lidar: float) -> NavigationEnv:
    world = WorldConfig(size=(60.0, 60.0), obstacles=6)
    return NavigationEnv(2, world=world, lidar=LidarConfig(max_range=4.0, **lidar), privileged=privileged, seed=1)


def acted(policy: str) -> TensorDictBase:
    loaded = load_policy(policy)
    env = loaded.make_env("randomize=none", num_uavs=2)
    flown = env.rollout(4, loaded)
    env.close()
    return flown


@pytest.mark.parametrize("policy", ["best", "best_dynamic"])
def test_a_packaged_policy_acts_as_ever(policy: str) -> None:
    expected = acted(policy)
    torch.set_default_dtype(torch.float64)
    try:
        found = acted(policy)
    finally:
        torch.set_default_dtype(torch.float32)
    for key in ("observation", "action", ("next", "reward")):
        assert found[key].dtype == torch.float32 and torch.equal(found[key], expected[key])


def test_a_policy_reads_observations_of_another_precision() -> None:
    loaded = load_policy("best")
    state = torch.rand(3, 237, generator=torch.Generator().manual_seed(0))
    single = loaded(TensorDict({"observation": state}, [3]))["action"]
    assert torch.equal(loaded(TensorDict({"observation": state.double()}, [3]))["action"], single)


def test_a_policy_says_how_many_numbers_it_reads() -> None:
    """For example those of other cells."""
    with pytest.raises(
        UavrlError, match="reads observations of 237 numbers and got 453: it needs the cells and frames"
    ):
        load_policy("best")(TensorDict({"observation": torch.zeros(3, 453)}, [3]))


@pytest.mark.usefixtures("doubles")
@pytest.mark.parametrize("name", [name for name in BASELINES if not name.startswith("rrt")])
def test_a_planner_acts(name: str) -> None:
    state = NavigationState(last_action=True, motion=12.0)
    for part in state.modules():
        if isinstance(part, PointCloudReduction):
            part.del_keys = False
    env = TransformedEnv(small("way", "mapped_way", "planes", "traps", far_range=12.0), Compose(state, InitTracker()))
    assert env.rollout(3, find_class(BASELINES[name], object)())["action"].dtype == torch.float32


@pytest.mark.usefixtures("doubles")
def test_the_specs_hold() -> None:
    full = NavigationState(reduction="range_image", motion=12.0, last_action=True)
    check_env_specs(TransformedEnv(small(far_range=12.0), Compose(Guarded(), full, NavigationReward())))


@pytest.mark.usefixtures("doubles")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_networks_take_data_of_either_precision(dtype: torch.dtype) -> None:
    state, action = torch.zeros(2, 105, dtype=dtype), torch.zeros(2, 4, dtype=dtype)
    for network, inputs in (
        (Actor(105, 4), [state]),
        (GaussianActor(105, 4), [state]),
        (Critic(105, 4), [state, action]),
        (SystemNet(105, 4), [state, action]),
        (RewardNet(105, 4), [state, state, action]),
        (PSAE(), [state]),
        (TrajectoryClassifier(k=5), [state]),
        (OneShotClassifier(), [state]),
    ):
        network(*inputs)
        network.float()(*inputs)


@pytest.mark.usefixtures("doubles")
def test_a_loss_learns_from_single_precision() -> None:
    loss = td3()
    data = {"observation": torch.zeros(3, 6), "action": torch.zeros(3, 2)}
    flags = {"done": torch.ones(3, 1, dtype=torch.bool), "terminated": torch.ones(3, 1, dtype=torch.bool)}
    batch = TensorDict({**data, "next": {"observation": torch.zeros(3, 6), "reward": torch.ones(3, 1), **flags}}, [3])
    single = batch.apply(lambda value: value.float() if value.is_floating_point() else value)
    for method in (loss.value_loss, loss.actor_loss):
        method(single)[0].backward()


@pytest.mark.usefixtures("doubles")
def test_buffers_relabel_and_mirror() -> None:
    states = torch.randn(9, 105, dtype=torch.float32)
    last = torch.arange(9)[:, None] == 8
    after = {"observation": states, "reward": torch.ones(9, 1, dtype=torch.float32), "done": last, "arrived": last}
    data = TensorDict({"observation": states, "action": torch.zeros(9, 4, dtype=torch.float32), "next": after}, [9])
    for backward in (ABR(stacked=3), ABRPlus()):
        assert backward.inv(data.clone())["next", "reward"].dtype == torch.float32
    image = Mirror(probability=1.0)(data)
    assert image["observation"].dtype == image["action"].dtype == torch.float32
    assert OneShotClassifier().weight.dtype == torch.float32
