from __future__ import annotations

import copy
from pathlib import Path

import pytest
import torch
from tensordict import LazyStackedTensorDict, TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.checkpoint import Checkpoint
from torchrl.data import LazyTensorStorage, ListStorage, PrioritizedSampler, ReplayBuffer, TensorDictReplayBuffer
from torchrl.envs import EnvBase, Transform

from tests.helpers.contracts import NESTINGS, TransformContract
from tests.helpers.small_env import SmallEnv
from uavrl.buffers import BackwardReward, TrajectoryHistory
from uavrl.errors import UavrlError
from uavrl.models import OneShotClassifier


def by_first(states: Tensor) -> Tensor:
    """The first number of a state is its class."""
    return states[:, 0].long()


def make_episode(reward: list[float], labels: list[float] | None = None, *, arrived: bool = True) -> TensorDict:
    """One episode; ``labels`` are what ``by_first`` reads at each step."""
    steps = len(reward)
    last = torch.arange(steps)[:, None] == steps - 1
    state = torch.zeros(steps, 2)
    state[:, 0] = torch.tensor(labels if labels is not None else [0.0] * steps)
    flags = {"done": last, "terminated": last & arrived, "arrived": last & arrived}
    after = {"observation": state + 100, "reward": torch.tensor(reward)[:, None], **flags}
    return TensorDict({"observation": state, "action": torch.zeros(steps, 1), "next": after}, [steps])


def rewards(data: TensorDictBase, key: str = "reward") -> list[float]:
    return data["next", key].squeeze(-1).tolist()


def make_buffer(transform: Transform, capacity: int = 100) -> ReplayBuffer:
    return ReplayBuffer(storage=LazyTensorStorage(capacity), batch_size=50, transform=transform)


UP = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 7.0]  # R = 3, 6: in one class it earns 0 and 1 multiplier
UP_RELABELLED = [1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 7.0]


class TestContract(TransformContract):
    def make_transform(self) -> Transform:
        return BackwardReward(by_first)

    @staticmethod
    def make_env() -> EnvBase:
        return SmallEnv()

    def make_data(self, *batch: int) -> TensorDict:
        """The third window of nine steps has the smallest sum: whoever has met it ranks the others higher."""
        return make_episode([float(5 * step % 7) for step in range(batch[0])])

    def apply(self, transform: Transform, data: TensorDictBase) -> Tensor | None:
        return self.output(transform.inv(data))

    def test_any_batch_shape(self) -> None:
        """``[2, 2, T]`` is stored as four rows, one after the other; a row may hold several episodes."""
        flat = torch.cat([make_episode(UP), make_episode([1.0, 2.0]), make_episode(UP), make_episode([3.0, 4.0])] * 2)
        out = BackwardReward(by_first, multiplier=1.0).inv(flat.reshape(2, 2, 9))
        assert out.shape == (2, 2, 9)
        assert rewards(out.reshape(-1)) == rewards(BackwardReward(by_first, multiplier=1.0).inv(flat))

    def test_as_a_module_in_a_model(self) -> None:
        data = self.make_data(6)
        assert (torch.nn.Sequential(self.make_transform())(data.clone()) == data).all(), "reading relabels nothing"

    def out_key(self) -> str:
        return "reward"

    @pytest.mark.parametrize("nested", NESTINGS)
    def test_env_matches_its_specs(self, nested: str) -> None:
        """It belongs in a buffer alone: an environment that holds it is refused at its first step."""
        with pytest.raises(ValueError, match="give it to a replay buffer, not an environment"):
            NESTINGS[nested](self.make_env, self.make_transform).rollout(2)


# ---------------------------------------------------------------------- which episodes, which steps


def test_the_algorithm_through_a_buffer() -> None:
    """The ten steps of test_functional.py, twice; the labels stand at the third, sixth and ninth observation."""
    labels = [0.0, 0, 4, 0, 0, 9, 0, 0, 4, 0]
    first = [1.0, 2.0, 0.5, 0.5, 0.25, 1.5, 2.0, 3.0, 1.0, 50.0]
    second = [0.5, 0.5, 0.5, *first[3:]]
    buffer = make_buffer(BackwardReward(by_first))
    buffer.extend(make_episode(first, labels))
    buffer.extend(make_episode(second, labels))
    stored = torch.tensor(rewards(buffer[:]))
    expected = [1.0, 2.0, 0.5, 0.5, 0.25, 1.5, 2.2, 3.2, 1.2, 50.0, 0.5, 0.5, 0.5, 0.5, 0.25, 1.5, 2.4, 3.4, 1.4, 50.0]
    assert torch.equal(stored, torch.tensor(expected))
    assert rewards(buffer[:], "reward_raw") == first + second


def test_the_state_of_a_window_is_the_one_of_its_last_action() -> None:
    seen: list[Tensor] = []

    def classifier(states: Tensor) -> Tensor:
        seen.append(states)
        return by_first(states)

    data = make_episode([1.0] * 8, [0.0, 1, 2, 3, 4, 5, 6, 7])
    BackwardReward(classifier).inv(data)
    BackwardReward(classifier, observation=("next", "observation")).inv(data)
    assert [states[:, 0].tolist() for states in seen] == [[2, 5], [102, 105]]


def test_several_episodes_in_one_write() -> None:
    """Only successes change; in the third, R = 3 and 6 are known: m = 0, 1."""
    parts = [make_episode(UP), make_episode(UP, arrived=False), make_episode(UP), make_episode([5.0])]
    out = BackwardReward(by_first, multiplier=1.0).inv(torch.cat(parts))
    assert rewards(out) == UP_RELABELLED + UP + UP_RELABELLED + [5.0]
    assert rewards(out, "reward_raw") == UP + UP + UP + [5.0]


def test_one_write_is_as_good_as_many() -> None:
    torch.manual_seed(0)
    episodes = [
        make_episode((torch.randn(n) * 3).tolist(), torch.randint(0, 3, (n,)).float().tolist(), arrived=n != 4)
        for n in (1, 2, 3, 7, 30, 4, 12)
    ]
    one, many = BackwardReward(by_first), BackwardReward(by_first)
    together = one.inv(torch.cat(episodes))
    assert rewards(together) == rewards(torch.cat([many.inv(episode) for episode in episodes]))
    assert all(torch.equal(v, many.get_extra_state()[k]) for k, v in one.get_extra_state().items())


def test_failed_episodes_teach_nothing() -> None:
    """An episode that reports success before its last step has failed, too."""
    early = make_episode(UP, arrived=False)
    early["next", "arrived"][2] = True
    transform = BackwardReward(by_first)
    out = transform.inv(torch.cat([make_episode(UP, arrived=False), early]))
    assert rewards(out) == rewards(out, "reward_raw") == UP * 2
    assert len(transform.history) == transform.episodes == 0
    assert transform.inv(make_episode(UP)[:0])["next", "reward_raw"].shape == (0, 1)


def test_labels_may_come_from_elsewhere() -> None:
    """A module's labels of another integer type, and a history that others have begun."""
    history = TrajectoryHistory()
    for value in (-5, -4):
        history.insert_and_rank(0, value)
    transform = BackwardReward(lambda states: by_first(states).int(), multiplier=1.0, history=history)
    assert rewards(transform.inv(make_episode(UP))) == [3.0, 3.0, 3.0, 5.0, 5.0, 5.0, 7.0]
    assert history.values(0) == [-5, -4, 3, 6]


def test_windows_of_another_length() -> None:
    out = BackwardReward(by_first, frames=2, multiplier=1.0).inv(make_episode([1.0, 0.0, 3.0, 0.0, 2.0, 0.0, 9.0]))
    assert rewards(out) == [1.0, 0.0, 4.0, 1.0, 3.0, 1.0, 9.0]  # R = 1, 3, 2: m = 0, 1, 1


@pytest.mark.parametrize("last_dimension", [True, False])
def test_keys_can_be_renamed_and_lack_a_last_dimension(last_dimension: bool) -> None:
    data = make_episode(UP)
    gain, won, over = (
        data["next", key] if last_dimension else data["next", key].squeeze(-1) for key in ("reward", "arrived", "done")
    )
    following = {"uav": {"gain": gain, "won": won}, "over": over}
    renamed = TensorDict({"uav": {"state": data["observation"]}, "next": following}, data.batch_size)
    transform = BackwardReward(
        by_first,
        multiplier=1.0,
        observation=("uav", "state"),
        reward=("next", "uav", "gain"),
        arrived=("next", "uav", "won"),
        done=("next", "over"),
        reward_raw="before",
    )
    out = transform.inv(renamed)
    assert out["next", "uav", "gain"].shape == gain.shape
    assert out["next", "uav", "gain"].flatten().tolist() == UP_RELABELLED
    assert out["before"].flatten().tolist() == UP


# ---------------------------------------------------------------------- TorchRL's write path


@pytest.mark.parametrize("stacked", [False, True])
def test_the_given_data_stay(stacked: bool) -> None:
    data = make_episode(UP)
    if stacked:
        data = LazyStackedTensorDict(*data.unbind(0), stack_dim=0)
    before, keys = data.clone(), set(data.keys(True, True))
    make_buffer(BackwardReward(by_first)).extend(data)
    assert set(data.keys(True, True)) - {"index"} == keys
    assert (data.select(*keys) == before).all()
    assert rewards(BackwardReward(by_first, multiplier=1.0).inv(make_episode(UP).lock_())) == UP_RELABELLED


def test_old_and_new_rewards_do_not_share_memory() -> None:
    buffer = ReplayBuffer(storage=ListStorage(100), transform=BackwardReward(by_first), collate_fn=torch.stack)
    data = make_episode(UP, arrived=False)
    buffer.extend(data)
    stored = buffer[3]
    stored["next", "reward"].fill_(77.0)
    assert data["next", "reward"].max() == buffer[3]["next", "reward_raw"] + 5.0 == 7.0


def test_beside_other_transforms_and_priorities() -> None:
    """As the training builds it on a GPU: a callable that moves samples comes after."""
    transform = BackwardReward(by_first, multiplier=1.0)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100), sampler=PrioritizedSampler(100, 0.6, 0.4), batch_size=32, transform=transform
    )
    buffer.append_transform(lambda batch: batch.to(torch.float64))
    buffer.extend(make_episode(UP))
    assert buffer.transform[0] is transform
    assert rewards(buffer.storage[:]) == UP_RELABELLED
    assert buffer.sample()["next", "reward_raw"].dtype == torch.float64


def test_a_buffer_that_processes_share_is_refused() -> None:
    with pytest.raises(RuntimeError, match="BackwardReward keeps replay-buffer write state"):
        ReplayBuffer(storage=LazyTensorStorage(10), transform=BackwardReward(by_first), shared=True)


def test_no_gradient_flows_and_none_is_asked_for() -> None:
    layer = nn.Linear(2, 3)
    data = make_episode(UP)
    assert not BackwardReward(lambda states: layer(states).argmax(-1)).inv(data)["next", "reward"].requires_grad


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda data: data[:-1],
            "Expected whole episodes, got 6 steps, and the last one does not end an episode: collect with",
        ),
        (lambda data: torch.stack([data, data.clone()])[:, :5], r"got steps \[2, 5\]"),
        (lambda data: torch.stack([data[:6], data[1:]]), r"got steps \[2, 6\]"),
        (lambda data: data[-1], "got a single step"),
        (lambda data: BackwardReward(by_first).inv(data), "relabelled before: restore the rewards"),
        (lambda data: data.set(("next", "reward"), torch.ones(7, 2)), r"one \('next', 'reward'\) for each step"),
        (lambda data: data.set(("next", "reward"), torch.full((7, 1), torch.nan)), "finite rewards"),
        (lambda data: data.set("observation", torch.zeros(7, 2, 2)), r"each window, \[2\], got torch.int64 \[2, 2\]"),
    ],
)
def test_what_is_no_whole_episode_is_refused(change, message: str) -> None:
    transform = BackwardReward(by_first)
    with pytest.raises(ValueError, match=message):
        make_buffer(transform).extend(change(make_episode(UP)))
    assert len(transform.history) == 0


@pytest.mark.parametrize("kind", [ReplayBuffer, TensorDictReplayBuffer])
def test_steps_on_their_own_are_refused(kind: type[ReplayBuffer]) -> None:
    buffer = kind(storage=LazyTensorStorage(100), transform=BackwardReward(by_first))
    buffer.extend(make_episode(UP))
    with pytest.raises(ValueError, match=r"Expected whole episodes.*got (a single step|1 steps)"):
        buffer.add(make_episode(UP)[0])
    with pytest.raises(ValueError, match="relabelled before"):
        buffer[:7] = buffer[:7]


@pytest.mark.parametrize("key", ["observation", ("next", "reward"), ("next", "arrived"), ("next", "done")])
def test_a_missing_key_is_named(key) -> None:
    with pytest.raises(KeyError, match=r"BackwardReward reads .*, but the data contain only .*name the right key"):
        BackwardReward(by_first).inv(make_episode(UP).exclude(key))


@pytest.mark.parametrize("name", ["reward", "arrived", "done"])
def test_an_entry_from_before_the_step_is_refused(name: str) -> None:
    """It is false, or zero, at the step that matters: no episode would ever count as a success."""
    data = make_episode(UP)
    data[name] = data["next", name].clone()
    with pytest.raises(UavrlError, match=rf"reads '{name}', .* before each step.*pass \('next', '{name}'\) instead"):
        BackwardReward(by_first, **{name: name}).inv(data)
    alone = data.set("won", data["next", "arrived"])
    assert BackwardReward(by_first, arrived="won").inv(alone) is not None, "a flag that is stored once may lie anywhere"


@pytest.mark.parametrize(
    "settings", [{"classifier": 3}, {"frames": 0}, {"multiplier": -0.1}, {"multiplier": float("nan")}]
)
def test_bad_settings_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(settings))):
        BackwardReward(**{"classifier": by_first} | settings)


# ---------------------------------------------------------------------- state


def random_episodes(seed: int) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    data = torch.cat([make_episode((3 * torch.randn(20, generator=generator)).tolist()) for _ in range(6)])
    return data.set("observation", torch.randn(120, 6, generator=generator))


def one_shot() -> OneShotClassifier:
    return OneShotClassifier(width=2, threshold=0.5)


@pytest.mark.parametrize("classifier", [lambda: lambda states: (states[:, 0] > 0).long(), one_shot])
@pytest.mark.parametrize("begun", [False, True])
def test_goes_on_from_a_checkpoint_as_if_never_stopped(classifier, begun: bool, tmp_path: Path) -> None:
    """Through TorchRL's pickle-free archive, with and without anything learned."""
    straight = BackwardReward(classifier())
    if begun:
        straight.inv(random_episodes(0))
    Checkpoint(backward_reward=straight, format="archive").save(tmp_path / "state.zip")
    resumed = BackwardReward(classifier())
    resumed.inv(random_episodes(5))
    Checkpoint(backward_reward=resumed, format="archive").load(tmp_path / "state.zip", map_location="cpu")
    one, other = (transform.inv(random_episodes(1)) for transform in (straight, resumed))
    assert (one == other).all()
    assert all(torch.equal(v, resumed.get_extra_state()[k]) for k, v in straight.get_extra_state().items())
    assert straight.mean_extra == resumed.mean_extra > 0


def test_a_buffers_state_dict_and_its_own_dump_carry_the_history(tmp_path: Path) -> None:
    one = make_buffer(BackwardReward(by_first))
    one.extend(make_episode(UP))
    one.dumps(tmp_path)
    for load in (lambda buffer: buffer.load_state_dict(one.state_dict()), lambda buffer: buffer.loads(tmp_path)):
        transform = BackwardReward(by_first)
        other = make_buffer(transform)
        other.extend(make_episode([1.0]))
        load(other)
        assert (transform.history.values(0), transform.episodes) == ([3, 6], 1)


def test_diagnostics() -> None:
    """Of the last episode: 3 of 7 steps earn 1 more. A deep copy counts for itself."""
    untouched = BackwardReward(by_first, multiplier=1.0)
    transform = copy.deepcopy(untouched)
    transform.inv(make_episode([1.0] * 3, [5.0] * 3))
    transform.inv(make_episode(UP))
    found = transform.diagnostics()
    seconds = found.pop("backward_seconds")
    assert found == {
        "backward_extra": pytest.approx(3 / 7),
        "backward_episodes": 2,
        "backward_classes": 2,
        "backward_values": 3,
    }
    assert 0 < seconds == transform.relabelling_seconds < 10
    assert set(untouched.diagnostics().values()) == {0.0}


@pytest.mark.gpu
def test_data_on_a_gpu() -> None:
    data = random_episodes(4)
    expected = BackwardReward(one_shot()).inv(data)
    found = BackwardReward(one_shot()).inv(data.to("cuda"))
    assert found["next", "reward"].is_cuda
    assert (found.cpu() == expected).all()
