"""One entry of what critics read and actors do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from uavrl.entries import entry
from uavrl.shown import Shown

PRIVILEGED = "privileged"


class Privileged(Shown, Transform):
    """Writes some of the quantities that an environment emits end to end into ``privileged``, for critics.

    Source: Pinto et al. (2018), Asymmetric Actor Critic for Image-Based Robot Learning (arXiv:1710.06542).

    Args:
        in_keys: what to write, ``[*B, D]`` each.
        divisors: of the quantities that are not in about [-1, 1], by their keys.

    Examples:
        >>> from tensordict import TensorDict
        >>> data = TensorDict({"wind": torch.tensor([5.0, 0.0]), "clearance": torch.tensor([2.0])})
        >>> Privileged(["wind", "clearance"], {"wind": 5.0})(data)["privileged"].tolist()
        [1.0, 0.0, 2.0]
    """

    def __init__(self, in_keys: Sequence[str], divisors: Mapping[str, float] | None = None) -> None:
        super().__init__(in_keys=list(in_keys), out_keys=[PRIVILEGED])
        self.divisors = dict(divisors or {})

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        parts = [entry(next_tensordict, key, self).float() / self.divisors.get(key, 1.0) for key in self.in_keys]
        return next_tensordict.set(PRIVILEGED, torch.cat(parts, -1))

    forward = _call

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the entry."""
        assert isinstance(observation_spec, Composite)
        width = sum(observation_spec[key].shape[-1] for key in self.in_keys)
        shape = (*observation_spec.shape, width)
        observation_spec[PRIVILEGED] = Unbounded(shape, dtype=torch.float32, device=observation_spec.device)
        return observation_spec
