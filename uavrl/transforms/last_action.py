"""The action that led to an observation, beside it."""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite, TensorSpec
from torchrl.envs.transforms import Transform

__all__ = ["LastAction"]


class LastAction(Transform):
    """Writes beside an observation which action led to it, zeros after a reset.

    What a vehicle was told a moment ago says how it moves now. Join it to the observation by TorchRL's ``CatTensors``.

    Args:
        in_keys: key of the action.
        out_keys: where the last one goes.

    Raises:
        ValueError: for another number of keys than one and one.

    Examples:
        >>> import torch
        >>> from torchrl.envs import GymEnv, TransformedEnv
        >>> env = TransformedEnv(GymEnv("Pendulum-v1"), LastAction())
        >>> env.rollout(3, lambda tensordict: tensordict.set("action", torch.ones(1)))["last_action"].flatten().tolist()
        [0.0, 1.0, 1.0]
    """

    def __init__(
        self, *, in_keys: Sequence[NestedKey] = ("action",), out_keys: Sequence[NestedKey] = ("last_action",)
    ) -> None:
        if len(in_keys) != 1 or len(out_keys) != 1:
            raise ValueError(f"LastAction takes one in_key and one out_key, got {list(in_keys)} and {list(out_keys)}.")
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Stored transitions with the action beside the next observation."""
        self._step(tensordict, tensordict.get("next"))
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.out_keys[0], tensordict.get(self.in_keys[0]))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set(self.out_keys[0], self._action_spec().zero())

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the last action, of the action's spec."""
        assert isinstance(observation_spec, Composite)
        observation_spec[self.out_keys[0]] = self._action_spec().clone()
        return observation_spec

    def _action_spec(self) -> TensorSpec:
        assert self.parent is not None, "only an environment's transform is reset"
        return self.parent.full_action_spec[self.in_keys[0]]
