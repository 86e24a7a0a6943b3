"""The backward reward as a replay buffer's transform."""

import time
from itertools import pairwise
from typing import Any, Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from uavrl.buffers.functional import backward_reward, check_labels, window_ends
from uavrl.buffers.history import TrajectoryHistory
from uavrl.entries import after_step, entry, require_whole
from uavrl.errors import UavrlError
from uavrl.shown import Shown


class StateClassifier(Protocol):
    """A function that puts states into classes, or a module, whose state then goes into checkpoints."""

    def __call__(self, states: Tensor, /) -> Tensor:
        """States ``[N, *S]`` in the order of time to int64 labels ``[N]``."""


class BackwardReward(Shown, Transform):
    """Relabels the rewards of successful episodes while a replay buffer stores them: ABR⁺, ABR, or your own.

    Chansuparp (2022), §3.4, Eq. 3.5, Algorithm 3.1; see :func:`uavrl.buffers.functional.backward_reward`. Every write
    holds whole episodes: ``[T]``, and each row of ``[*B, T]``, may hold several, end to end. Other episodes keep their
    rewards; all episodes keep the old rewards, too. Neither sampled data nor the data of a write are modified.

    A window's state is s_Z of Algorithm 3.1, in which the window's last action is taken: the ``observation`` of its
    last transition. For the state after it pass ``observation=("next", "observation")``. All keys are full keys.

    Args:
        classifier: puts states into classes.
        frames: p_frames, steps in a window.
        multiplier: p_addReward (Table 4.1: "extra reward multiplier").
        history: H to start from; by default an empty one.
        observation: key of the states ``[*B, T, *S]``.
        reward: key of the rewards, one for each step, before and after.
        arrived: key of the flag of success on an episode's last step.
        done: key of the flag that marks the last step of each episode.
        reward_raw: key for the old rewards.

    Raises:
        ValueError: for bad settings; at a write, for parts of episodes, data that was relabelled before, labels that
            are no integers and rewards that are not finite; inside an environment.
        MissingEntry: at a write, when a key is missing.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, ReplayBuffer
        >>> transform = BackwardReward(lambda states: (states[:, 0] > 0).long(), multiplier=0.5)
        >>> buffer = ReplayBuffer(storage=LazyTensorStorage(100), transform=transform)
        >>> last = torch.arange(6)[:, None] == 5
        >>> reward = torch.tensor([[1.0], [1.0], [1.0], [2.0], [2.0], [2.0]])
        >>> after = TensorDict({"reward": reward, "done": last, "arrived": last}, [6])
        >>> _ = buffer.extend(TensorDict({"observation": torch.ones(6, 2), "next": after}, [6]))
        >>> buffer[:]["next", "reward"].squeeze(-1).tolist()
        [1.0, 1.0, 1.0, 2.5, 2.5, 2.5]
    """

    # Processes that share a buffer would each have their own history: TorchRL refuses such a buffer.
    requires_shared_write_state = True

    def __init__(
        self,
        classifier: StateClassifier,
        frames: int = 3,
        multiplier: float = 0.2,
        *,
        history: TrajectoryHistory | None = None,
        observation: NestedKey = "observation",
        reward: NestedKey = ("next", "reward"),
        arrived: NestedKey = ("next", "arrived"),
        done: NestedKey = ("next", "done"),
        reward_raw: NestedKey = ("next", "reward_raw"),
    ) -> None:
        super().__init__(in_keys_inv=[observation, reward, arrived, done], out_keys_inv=[reward, reward_raw])
        if not callable(classifier):
            raise ValueError(f"Expected a classifier that takes states, got {type(classifier).__name__}.")
        window_ends(0, frames)
        if not 0.0 <= multiplier < float("inf"):
            raise ValueError(f"Expected a multiplier of at least 0, got {multiplier}: Table 4.1 has 0.2.")
        self.classifier = classifier
        self.frames = frames
        self.multiplier = multiplier
        self.history = TrajectoryHistory() if history is None else history
        self.episodes = 0
        self.mean_extra = 0.0
        self.relabelling_seconds = 0.0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns sampled data unchanged."""
        return tensordict

    @torch.no_grad()
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Sets the new rewards of whole episodes, in the shallow copy that ``inv`` has made."""
        if self.parent is not None:
            raise ValueError("BackwardReward relabels stored data: give it to a replay buffer, not an environment.")
        reward_key, raw_key = self.out_keys_inv
        if tensordict.get(raw_key, None) is not None:
            raise ValueError(
                f"Expected the environment's rewards, got data that was relabelled before: restore the rewards from "
                f"{raw_key!r}, and drop that key."
            )
        for key in self.in_keys_inv[1:]:
            self._require_after(tensordict, key)
        states, reward, arrived, done = (self._steps(tensordict, key) for key in self.in_keys_inv)
        require_whole(_one_a_step(done, "done").reshape(tensordict.batch_size))
        start_time = time.perf_counter()
        steps = (_one_a_step(reward, reward_key), _one_a_step(arrived, "arrived"), _one_a_step(done, "done"))
        self.prepare(states, steps[-1])
        new = self.relabel(states, *steps)
        self.relabelling_seconds += time.perf_counter() - start_time
        old = tensordict.get(reward_key)
        return tensordict.set(raw_key, old.clone()).set(reward_key, new.reshape(old.shape))

    def _require_after(self, tensordict: TensorDictBase, key: NestedKey) -> None:
        """Refuse the key of an entry before the step where the data hold the one after it, too."""
        after = after_step(key)
        if after != key and tensordict.get(after, None) is not None:
            raise UavrlError(
                f"{type(self).__name__} reads {key!r}, which is its value before each step, and the data also hold "
                f"{after!r}, its value after it: pass {after!r} instead."
            )

    def _steps(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        """An entry with its batch dimensions flattened to one of time."""
        value = entry(tensordict, key, self)
        if not tensordict.batch_dims:
            raise UavrlError("Expected whole episodes [T], got a single step: collect an episode, then extend.")
        return value.flatten(0, tensordict.batch_dims - 1)

    def prepare(self, states: Tensor, done: Tensor) -> None:
        """Look at the states ``[T, *S]`` of a write before it is relabelled: a classifier may have to fit them."""

    def relabel(self, states: Tensor, reward: Tensor, arrived: Tensor, done: Tensor) -> Tensor:
        """New rewards ``[T]`` of whole episodes, end to end; override it for another rule."""
        successes = [(start, end) for start, end in episode_bounds(done) if arrived[end - 1]]
        windows = [window_ends(end - start, self.frames) + start for start, end in successes]
        new = reward.clone()
        if not successes:
            return new
        at = torch.cat(windows).to(states.device)
        labels = self.classifier(states[at]) if len(at) else at
        check_labels(labels, len(at))
        parts = labels.split([len(ends) for ends in windows])
        for (start, end), part in zip(successes, parts, strict=True):
            old = reward[start:end]
            new[start:end] = backward_reward(old, part, self.history, frames=self.frames, multiplier=self.multiplier)
            self.mean_extra = float((new[start:end] - old).double().mean())
        self.episodes += len(successes)
        return new

    def diagnostics(self) -> dict[str, float]:
        """Numbers to log.

        ``backward_extra`` is the mean extra reward per step of the last successful episode, ``backward_episodes`` the
        number of relabelled episodes, ``backward_classes`` and ``backward_values`` the size of the history,
        ``backward_seconds`` the time spent relabelling since the object was made.
        """
        return {
            "backward_extra": self.mean_extra,
            "backward_episodes": self.episodes,
            "backward_classes": len(self.history.classes),
            "backward_values": len(self.history),
            "backward_seconds": self.relabelling_seconds,
        }

    def get_extra_state(self) -> dict[str, Any]:
        """The history and the counters as tensors, for ``state_dict``."""
        mean_extra = torch.tensor(self.mean_extra, dtype=torch.float64)
        return self.history.state_dict() | {"episodes": torch.tensor(self.episodes), "mean_extra": mean_extra}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`get_extra_state` gave, for ``load_state_dict``."""
        self.history.load_state_dict(state)
        self.episodes, self.mean_extra = int(state["episodes"]), float(state["mean_extra"])


def _one_a_step(value: Tensor, name: NestedKey) -> Tensor:
    """``[T]`` from ``[T]`` or ``[T, 1]``."""
    if value.numel() != len(value):
        raise ValueError(f"Expected one {name!r} for each step, got {list(value.shape)} for {len(value)} steps.")
    return value.reshape(-1)


def episode_bounds(done: Tensor) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each episode."""
    return list(pairwise([0, *(done.nonzero()[:, 0] + 1).tolist()]))
