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


class StateClassifier(Protocol):
    """Anything that puts states into classes: a function, or a module (whose state then goes into checkpoints).

    Examples:
        >>> def by_quadrant(states: Tensor) -> Tensor:
        ...     return 2 * (states[:, 0] > 0).long() + (states[:, 1] > 0).long()
        >>> classifier: StateClassifier = by_quadrant
        >>> classifier(torch.tensor([[0.3, -1.0], [2.0, 0.1]])).tolist()
        [2, 3]
    """

    def __call__(self, states: Tensor, /) -> Tensor:
        """States ``[N, *S]``, in the order flown, to int64 labels ``[N]``."""


class BackwardReward(Transform):
    """Relabels the rewards of episodes that arrive, while a replay buffer stores them: ABR⁺, ABR, or your own.

    Chansuparp (2022), §3.4, Eq. 3.5, Algorithm 3.1; see :func:`uavrl.buffers.functional.backward_reward`. The
    classifier decides which it is. Every write holds whole episodes: flat data ``[T]`` may hold several, end to
    end, and so may each row of ``[*B, T]``. Episodes that did not arrive keep their rewards, and all keep a copy
    from before. Sampling changes nothing, and neither does a write change the data that it is given.

    The state that stands for a window is s_Z of Algorithm 3.1, in which the window's last action is taken: the
    ``observation`` of the window's last transition, not the one after it. For the other reading pass
    ``observation=("next", "observation")``. All keys are full keys.

    Args:
        classifier: puts states into classes.
        frames: p_frames, steps in a window.
        multiplier: p_addReward (Table 4.1: "extra reward multiplier").
        history: H to start from; a new one if not given.
        observation: key of the states, ``[*B, T, *S]``.
        reward: key of the rewards, one a step; the relabelled ones go there.
        arrived: key of the flag that the last step of an episode carries if it arrived.
        done: key of the flag that marks the last step of each episode.
        reward_raw: where the rewards from before go.

    Raises:
        ValueError: for bad settings; at a write, for half episodes, data that was relabelled before, labels that
            are no integers and rewards that are not finite, and inside an environment.
        KeyError: at a write, when a key is missing.

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

    # A buffer that processes share would give each process a history of its own: TorchRL refuses it.
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
        """Sampled data as it is."""
        return tensordict

    @torch.no_grad()
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Whole episodes to whole episodes with new rewards; ``inv`` has made a shallow copy before."""
        if self.parent is not None:
            raise ValueError("BackwardReward relabels what is stored: give it to a replay buffer, not an environment.")
        reward_key, raw_key = self.out_keys_inv
        if tensordict.get(raw_key, None) is not None:
            raise ValueError(
                f"Expected rewards as the environment gave them, got data that was relabelled before: put back what "
                f"{raw_key!r} holds, and drop that key."
            )
        states, reward, arrived, done = (self._steps(tensordict, key) for key in self.in_keys_inv)
        _check_whole(done, tensordict.batch_size)
        start_time = time.perf_counter()
        new = self.relabel(
            states, _one_a_step(reward, reward_key), _one_a_step(arrived, "arrived"), _one_a_step(done, "done")
        )
        self.relabelling_seconds += time.perf_counter() - start_time
        old = tensordict.get(reward_key)
        return tensordict.set(raw_key, old.clone()).set(reward_key, new.reshape(old.shape))

    def _steps(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        """An entry with its batch dimensions flattened to the order flown."""
        value = tensordict.get(key, None)
        if value is None:
            raise KeyError(
                f"BackwardReward expected the key {key!r} and found {list(tensordict.keys(True, True))}: "
                f"store it, or name the right key in the constructor."
            )
        if not tensordict.batch_dims:
            raise ValueError("Expected whole episodes [T], got a single step: collect an episode, then extend.")
        return value.flatten(0, tensordict.batch_dims - 1)

    def relabel(self, states: Tensor, reward: Tensor, arrived: Tensor, done: Tensor) -> Tensor:
        """New rewards ``[T]`` of flat data that holds whole episodes; a rule of one's own overrides this."""
        arrivals = [(start, end) for start, end in episode_bounds(done) if arrived[end - 1]]
        windows = [window_ends(end - start, self.frames) + start for start, end in arrivals]
        new = reward.clone()
        if not arrivals:
            return new
        at = torch.cat(windows).to(states.device)
        labels = self.classifier(states[at]) if len(at) else at
        check_labels(labels, len(at))
        parts = labels.split([len(ends) for ends in windows])
        for (start, end), part in zip(arrivals, parts, strict=True):
            steps = slice(start, end)
            new[steps] = backward_reward(
                reward[steps], part, self.history, frames=self.frames, multiplier=self.multiplier
            )
            self.mean_extra = float((new[steps] - reward[steps]).double().mean())
        self.episodes += len(arrivals)
        return new

    def diagnostics(self) -> dict[str, float]:
        """What to log.

        Returns:
            ``backward_extra``: mean extra reward a step of the last episode that arrived; ``backward_episodes``:
            episodes relabelled; ``backward_classes`` and ``backward_values``: size of the history;
            ``backward_seconds``: spent relabelling since the object was made.
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


def _check_whole(done: Tensor, batch_size: torch.Size) -> None:
    """Refuses data in which the last step of a row ends no episode."""
    if done.numel() and not bool(_one_a_step(done, "done").reshape(batch_size)[..., -1].all()):
        raise ValueError(
            f"Expected whole episodes, got steps {list(batch_size)} the last of which ends none: "
            f"collect with trajs_per_batch=1 and traj_format='cat'."
        )


def episode_bounds(done: Tensor) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each episode."""
    return list(pairwise([0, *(done.nonzero()[:, 0] + 1).tolist()]))
