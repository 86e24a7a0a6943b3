"""A demonstrator, such as a scripted controller: it flies the first steps, and acts beside the policy in each state."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Transform

from uavrl.entries import entry
from uavrl.policy_protocol import Acts
from uavrl.shown import Shown

DEMONSTRATOR_ACTION = "demonstrator_action"


class Demonstrator(Shown, Transform):
    """A transform that writes the demonstrator's action beside each observation.

    Args:
        demonstrator: writes ``action`` into a TensorDict with the environment's observations.
        in_keys: what it reads.
        actions: numbers in an action.
    """

    def __init__(self, demonstrator: Acts, in_keys: Any, actions: int) -> None:
        super().__init__(in_keys=list(in_keys), out_keys=[DEMONSTRATOR_ACTION])
        self.demonstrator, self.actions = demonstrator, actions

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.in_keys:
            entry(next_tensordict, key, self)
        return next_tensordict.set(DEMONSTRATOR_ACTION, self.demonstrator(next_tensordict.copy())["action"])

    forward = _call

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the demonstrator's action."""
        assert isinstance(observation_spec, Composite)
        observation_spec[DEMONSTRATOR_ACTION] = Unbounded((*observation_spec.shape, self.actions), dtype=torch.float32)
        return observation_spec


class DemonstratorEnv(TransformedEnv):
    """An environment whose "random" actions, with which TorchRL's collectors begin, are a demonstrator's with noise.

    So successful episodes are in the buffer from the first update on (after Uchendu et al. (2023), Jump-Start
    Reinforcement Learning, arXiv:2204.02372, whose guide policy begins every episode). It holds a
    :class:`Demonstrator`.
    """

    noise: Acts

    def rand_action(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        """Return the demonstrator's action, with noise."""
        tensordict = self.reset() if tensordict is None else tensordict
        return self.noise(tensordict.set("action", tensordict[DEMONSTRATOR_ACTION].clone()))
