"""A demonstrator, such as a scripted controller: it flies the first steps, and acts beside the policy in each state."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Transform

from uavrl.entries import entry
from uavrl.errors import UavrlError
from uavrl.policy_protocol import Acts
from uavrl.shown import Shown

DEMONSTRATOR_ACTION = "demonstrator_action"
_RESET = "_reset"  # TorchRL's key of those that begin an episode


class Demonstrator(Shown, Transform):
    """A transform that writes the demonstrator's action beside each observation.

    When some of several vehicles begin an episode, the demonstrator is asked again for all of them, and only its answer
    for those that begin counts. The entry ``_reset`` ``bool [*B, 1]``, which it has only then, says which these are: a
    demonstrator with a memory must leave that of the others as it is.

    Args:
        demonstrator: writes ``action`` into a TensorDict with the environment's observations.
        in_keys: what it reads.
        actions: numbers in an action.
        limit: the largest action, to which larger ones are cut as the environment does it; None: there is none.

    Raises:
        UavrlError: when called, for a demonstrator that writes no ``action``, or one of another shape or with NaN.
    """

    def __init__(self, demonstrator: Acts, in_keys: Any, actions: int, limit: float | None = None) -> None:
        super().__init__(in_keys=list(in_keys), out_keys=[DEMONSTRATOR_ACTION])
        self.demonstrator, self.actions, self.limit = demonstrator, actions, limit

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.in_keys:
            entry(next_tensordict, key, self)
        try:
            acted = self.demonstrator(next_tensordict.exclude("action"))
        except KeyError as error:
            if "not found in TensorDict" not in str(error):  # it may have tables of its own
                raise
            raise UavrlError(
                f"The demonstrator {self._name()} reads an entry that its in_keys do not name ({error.args[0]}): add "
                "it to them."
            ) from error
        action = acted.get("action", None) if isinstance(acted, TensorDictBase) else None
        self._require_action(action, (*next_tensordict.batch_size, self.actions))
        assert action is not None
        kept = (
            action.to(torch.float32) if self.limit is None else action.to(torch.float32).clamp(-self.limit, self.limit)
        )
        return next_tensordict.set(DEMONSTRATOR_ACTION, kept)

    def _require_action(self, action: Any, shape: tuple[int, ...]) -> None:
        """Refuse what cannot be flown, in the name of who made it."""
        if not isinstance(action, torch.Tensor):
            wrong = "none: set it in the TensorDict, and return that"
        elif action.shape != shape:
            wrong = f"the shape {list(action.shape)}"
        elif not action.isfinite().all():
            wrong = "NaN or infinity"
        else:
            return
        raise UavrlError(
            f"The demonstrator {self._name()} must write action, finite numbers of shape {list(shape)}, got {wrong}."
        )

    def _name(self) -> str:
        return str(getattr(self.demonstrator, "__name__", type(self.demonstrator).__name__))

    forward = _call

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        begin = None if tensordict is None else tensordict.get(_RESET, None)
        if begin is None:
            return self._call(tensordict_reset)
        made = self._call(tensordict_reset.copy().set(_RESET, begin))
        action, before = made[DEMONSTRATOR_ACTION], tensordict.get(DEMONSTRATOR_ACTION, None)
        if before is not None:
            action = torch.where(begin, action, before)
        return tensordict_reset.set(DEMONSTRATOR_ACTION, action)

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
