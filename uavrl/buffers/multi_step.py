"""n-step returns of whole episodes."""

import torch
from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform

from uavrl.buffers.functional import multi_step_returns
from uavrl.entries import entry
from uavrl.shown import Shown


class MultiStep(Shown, Transform):
    """Turns whole episodes into n-step transitions while a replay buffer stores them.

    The reward becomes the n-step return. All else under ``"next"``, the flags included, comes from n steps later, or
    from the episode's end. TorchRL's value estimators discount by ``steps_to_next_obs [T, 1]``.

    Unlike :class:`torchrl.envs.transforms.MultiStepTransform` it writes the last steps of an episode with the episode,
    not at the next write, and moves ``terminated`` with the state, so that nothing bootstraps from an end.

    Args:
        n_steps: n.
        gamma: discount γ, that of the loss.

    Raises:
        ValueError: for settings out of range; at a write, for half episodes.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, ReplayBuffer
        >>> buffer = ReplayBuffer(storage=LazyTensorStorage(10), transform=MultiStep(2, gamma=0.5))
        >>> last = torch.tensor([[False], [False], [True]])
        >>> after = {"observation": torch.tensor([[1.0], [2.0], [3.0]]), "reward": torch.ones(3, 1), "done": last}
        >>> _ = buffer.extend(TensorDict({"observation": torch.tensor([[0.0], [1.0], [2.0]]), "next": after}, [3]))
        >>> buffer[:]["next", "reward"].flatten().tolist(), buffer[:]["next", "observation"].flatten().tolist()
        ([1.5, 1.5, 1.0], [2.0, 3.0, 3.0])
        >>> buffer[:]["steps_to_next_obs"].flatten().tolist()
        [2, 2, 1]
    """

    def __init__(self, n_steps: int, gamma: float) -> None:
        if n_steps < 1 or not 0.0 <= gamma <= 1.0:
            raise ValueError(f"Expected n_steps of at least 1 and gamma in [0, 1], got {n_steps} and {gamma}.")
        super().__init__()
        self.n_steps = n_steps
        self.gamma = gamma

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Sampled data as it is."""
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Whole episodes ``[T]``, end to end; ``inv`` has made a shallow copy before."""
        reward, done = (entry(tensordict, ("next", key), self) for key in ("reward", "done"))
        after = tensordict.get("next")
        returns, steps = multi_step_returns(reward.flatten(), done.flatten(), self.gamma, self.n_steps)
        reached = after[torch.arange(len(steps), device=steps.device) + steps - 1]
        tensordict.set("next", reached.set("reward", returns.reshape(reward.shape)))
        return tensordict.set("steps_to_next_obs", steps.unsqueeze(-1))
