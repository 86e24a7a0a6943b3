"""First steps that a guide flies, and not chance."""

from collections.abc import Callable

from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv


class GuidedEnv(TransformedEnv):
    """An environment whose "random" actions, which TorchRL's collectors begin with, are a guide's with noise.

    Flights that arrive are in the buffer from the first update on (after Uchendu et al. (2023), Jump-Start
    Reinforcement Learning, arXiv:2204.02372, whose guide begins every flight).

    Attributes:
        guide: writes ``action`` into a TensorDict with the environment's observations.
        noise: adds exploration noise to it.
    """

    guide: Callable[[TensorDictBase], TensorDictBase]
    noise: Callable[[TensorDictBase], TensorDictBase]

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """The guide's action, with noise."""
        return self.noise(self.guide(self.reset() if tensordict is None else tensordict))
