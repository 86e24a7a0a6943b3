"""The rewards by which FORK's authors teach the hard-core bipedal walker."""

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs.transforms import Transform

from uavrl.ranges import Positive
from uavrl.transforms.rewards import with_reward


def walker_reward(reward_t: Tensor, fell_t: Tensor, *, fall_reward: float = -5.0, scale: float = 5.0) -> Tensor:
    """A fall costs little, every other reward counts more (Chansuparp (2022), §4.5; Wei & Ying (2020), their code).

    Args:
        reward_t: the environment's reward, ``[*B]``.
        fell_t: bool ``[*B]``.
        fall_reward: what a fall gives instead of -100.
        scale: factor on every other reward.

    Raises:
        ValueError: when the shapes differ.

    Examples:
        >>> walker_reward(torch.tensor([0.5, -100.0, -0.25]), torch.tensor([False, True, False])).tolist()
        [2.5, -5.0, -1.25]
    """
    if reward_t.shape != fell_t.shape:
        raise ValueError(f"Expected one flag a reward, got {list(fell_t.shape)} for {list(reward_t.shape)}.")
    return torch.where(fell_t, fall_reward, scale * reward_t)


class WalkerReward(Transform):
    """Two of FORK's heuristics for the hard-core walker, see :func:`walker_reward`.

    Put TorchRL's ``RewardSum`` before it to keep the return that the environment gave.

    Args:
        fall_reward: what a fall gives instead of -100.
        scale: factor on every other reward.
        reward: key of the reward, which is overwritten.
        fell: key of the bool that tells a fall.

    Raises:
        KeyError: when a key is missing from the data.

    Examples:
        >>> from torchrl.envs import Compose, RewardSum, TransformedEnv
        >>> from uavrl.envs.bipedal import BipedalEnv
        >>> env = TransformedEnv(BipedalEnv(max_steps=9), Compose(RewardSum(), WalkerReward()))
        >>> after = env.rollout(9)["next"]
        >>> torch.allclose(after["reward"].sum(0), 5 * after["episode_reward"][-1])
        True
    """

    def __init__(
        self,
        fall_reward: float = -5.0,
        scale: Positive = 5.0,
        *,
        reward: NestedKey = "reward",
        fell: NestedKey = "collided",
    ) -> None:
        super().__init__(in_keys=[reward, fell], out_keys=[reward])
        self.fall_reward = fall_reward
        self.scale = scale

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward, fell = (next_tensordict.get(key, None) for key in self.in_keys)
        if reward is None or fell is None:
            raise KeyError(
                f"WalkerReward expected the keys {self.in_keys} and found {list(next_tensordict.keys())}: emit them "
                f"from the environment, or name the right ones in the constructor."
            )
        new = walker_reward(reward, fell, fall_reward=self.fall_reward, scale=self.scale)
        return next_tensordict.set(self.out_keys[0], new)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Changes the rewards of stored transitions, which must be as the environment gave them."""
        return tensordict.set("next", self._step(tensordict, tensordict.get("next").copy()))

    def transform_reward_spec(self, reward_spec: TensorSpec) -> TensorSpec:
        """The reward is one unbounded float per environment."""
        return with_reward(reward_spec, self.out_keys[0])
