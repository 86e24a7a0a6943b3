"""A transform that misses an entry names it in one sentence, and each transform shows its constructor call."""

from __future__ import annotations

import copy
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, Transform, TransformedEnv

from uavrl.buffers import MultiStep
from uavrl.entries import MissingEntry, require_whole
from uavrl.errors import UavrlError
from uavrl.transforms import (
    Guarded,
    LastAction,
    Mirror,
    MovingObjects,
    NavigationObservation,
    NavigationReward,
    NavigationState,
    RangeImage,
    Threats,
    TraditionalReward,
    TruncatedIcosahedron,
)
from uavrl_onboard.perception.cells import RangeGrid

SHAPES = {
    "point_cloud": (16, 3),
    "velocity": (3,),
    "attitude": (3,),
    "altitude": (1,),
    "heading_deg": (1,),
    "elevation_deg": (1,),
    "distance": (1,),
    "arrived": (1,),
    "collided": (1,),
    "faces": (32,),
    "moving_objects": (21,),
}


class Foreign(EnvBase):
    """Emits what NavigationEnv does, but for some keys."""

    def __init__(self, without: str = "") -> None:
        super().__init__(batch_size=torch.Size([2]))
        self.shapes = {key: shape for key, shape in SHAPES.items() if key != without}
        flags = ("arrived", "collided")
        specs = {
            key: Unbounded((2, *shape), dtype=torch.bool if key in flags else torch.float32)
            for key, shape in self.shapes.items()
        }
        self.observation_spec = Composite(specs, shape=(2,))
        self.action_spec = Bounded(-1.0, 1.0, (2, 4))
        self.reward_spec = Unbounded((2, 1))

    def _set_seed(self, seed: int | None) -> None: ...

    def _reset(self, tensordict: TensorDict | None = None) -> TensorDict:
        return self.observation_spec.zero()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        flags = {key: torch.zeros(2, 1, dtype=torch.bool) for key in ("done", "terminated")}
        return self._reset().update({"reward": torch.ones(2, 1), **flags})


def objects() -> Transform:
    return MovingObjects(every=1)


# What reads which key, and whether the specs tell that it is missing.
READERS: list[tuple[Callable[[], Transform], str, bool]] = [
    (TruncatedIcosahedron, "point_cloud", True),
    (RangeImage, "point_cloud", True),
    (NavigationObservation, "altitude", True),
    (NavigationState, "point_cloud", True),
    (NavigationState, "altitude", True),
    (lambda: NavigationState(motion=12.0), "attitude", True),
    (objects, "attitude", True),
    (Threats, "moving_objects", True),
    (Threats, "velocity", True),
    (Guarded, "heading_deg", True),
    (Guarded, "point_cloud", True),
    (TraditionalReward, "distance", False),
    (NavigationReward, "elevation_deg", False),
    (lambda: LastAction(in_keys=["command"]), "command", True),
]


@pytest.mark.parametrize(("make", "key", "told"), READERS)
def test_an_environment_without_a_key_is_told_which(make: Callable[[], Transform], key: str, told: bool) -> None:
    env = TransformedEnv(Foreign(without=key), make())
    if told:
        with pytest.raises(MissingEntry, match=f"^[A-Za-z]+ reads '{key}', but the environment emits only .*: name"):
            _ = env.observation_spec
    env = TransformedEnv(Foreign(without=key), make())
    with pytest.raises(UavrlError, match=rf"^[A-Za-z]+ reads '{key}', but the (data contain|environment emits) only"):
        env.rollout(2)


@pytest.mark.parametrize("make", [NavigationState, lambda: NavigationState(motion=12.0), NavigationReward])
def test_with_all_keys_the_same_environment_is_read(make: Callable[[], Transform]) -> None:
    assert TransformedEnv(Foreign(), make()).rollout(2).batch_size == (2, 2)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (TruncatedIcosahedron, "point_cloud"),
        (NavigationObservation, "faces"),
        (NavigationState, "point_cloud"),
        (Threats, "moving_objects"),
        (LastAction, "next"),
        (TraditionalReward, "next"),
        (Mirror, "action"),
    ],
)
def test_stored_data_without_a_key_are_told_which(make: Callable[[], Transform], key: str) -> None:
    with pytest.raises(MissingEntry, match=f"reads '{key}', but the data contain only"):
        make()(TensorDict({"observed": torch.zeros(3, 35)}, [3]))
    assert isinstance(MissingEntry("A", key, "the data contain", []), KeyError), "as TorchRL's transforms raise"


def test_multi_step_names_what_it_misses() -> None:
    with pytest.raises(MissingEntry, match=r"MultiStep reads \('next', 'reward'\)"):
        MultiStep(2, 0.9).inv(TensorDict({"next": {"done": torch.ones(3, 1, dtype=torch.bool)}}, [3]))


@pytest.mark.parametrize(
    ("made", "shown"),
    [
        (lambda: NavigationState(), "NavigationState()"),
        (lambda: NavigationState(3.0, reduction="range_image"), "NavigationState(radius=3.0, reduction='range_image')"),
        (
            lambda: NavigationObservation(in_keys=["a", "b", "c", "d"]),
            "NavigationObservation(in_keys=['a', 'b', 'c', 'd'])",
        ),
        (lambda: LastAction(in_keys=["action"]), "LastAction()"),
        (lambda: Mirror(probability=1.0), "Mirror(probability=1.0)"),
        (lambda: MovingObjects(8.0, every=5), "MovingObjects(max_range=8.0, every=5)"),
        (lambda: Threats(out_keys=["ways"]), "Threats(out_keys=['ways'])"),
        (lambda: Guarded("map"), "Guarded(guards='map')"),
        (lambda: TraditionalReward(arrived=("agent", "won")), "TraditionalReward(arrived=('agent', 'won'))"),
        (lambda: NavigationReward(arrived_reward=200.0), "NavigationReward(arrived_reward=200.0)"),
        (lambda: MultiStep(3, gamma=0.9), "MultiStep(n_steps=3, gamma=0.9)"),
    ],
)
def test_a_transform_shows_its_constructor_call(made: Callable[[], Transform], shown: str) -> None:
    transform = made()
    assert repr(transform) == shown
    assert repr(copy.copy(transform)) == shown


def test_a_reduction_shows_its_keys_and_its_grid() -> None:
    assert repr(RangeImage(radius=2.0)).endswith("radius=2.0, statistic='proximity', del_keys=True)")
    shown = repr(RangeImage(columns=36, rows=2, elevation=(-25, 15)))
    assert shown.endswith("del_keys=True, columns=36, rows=2, elevation=(-25.0, 15.0))")
    made = eval(shown)  # it is one of our own
    assert made.grid == RangeGrid(36, 2, (-25.0, 15.0))


@pytest.mark.parametrize(
    ("done", "flat", "told"),
    [
        (torch.zeros(60, dtype=torch.bool), False, "got 60 steps, and the last one does not end an episode"),
        (torch.zeros(2, 30, dtype=torch.bool), False, r"got steps \[2, 30\], and the last one does not end an episode"),
        (torch.ones(2, 30, dtype=torch.bool), True, r"got steps \[2, 30\], and they are not in one row \[T\]"),
        (torch.ones((), dtype=torch.bool), False, r"got steps \[\], and"),
        (torch.zeros(0, dtype=torch.bool), True, "got 0 steps"),
    ],
)
def test_what_is_no_whole_episode_is_told_how_to_collect(done: torch.Tensor, flat: bool, told: str) -> None:
    with pytest.raises(UavrlError, match=told + r".*trajs_per_batch=1, traj_format='cat'"):
        require_whole(done, flat=flat)


def test_whole_episodes_pass() -> None:
    require_whole(torch.tensor([[False, True], [True, True]]))
    require_whole(torch.zeros(0, dtype=torch.bool))
    require_whole(torch.tensor([True]), flat=True)
