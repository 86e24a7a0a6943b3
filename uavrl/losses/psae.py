"""The all-positive Siamese autoencoder's loss (Chansuparp (2022), Eq. 3.3) as a TorchRL loss module."""

from dataclasses import dataclass
from typing import Any, NoReturn

import torch
import torch.nn.functional as F
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase, dispatch
from torch import Tensor, nn
from torchrl.objectives import LossModule

from uavrl.errors import UavrlError


class PSAELoss(LossModule):
    """Reconstructs a state and its two neighbours, and pulls the three features to one direction (Eq. 3.3).

    ``L = p Σ‖s - s̃‖² - (1 - p) (cos(ŝ_t, ŝ_{t-1}) + cos(ŝ_t, ŝ_{t+1}))``. It reads the state at t, the one before
    under ``("previous", "observation")`` and the one after under ``("next", "observation")``. The three must be
    of one episode; :func:`uavrl.pretraining.triple_centres` finds such triples.

    Args:
        network: a module from states to features and reconstructions such as :class:`uavrl.models.PSAE`, or a
            TensorDictModule that reads one key and writes these two.
        tradeoff: p_wae (Table 4.1: 0.7).
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Raises:
        ValueError: for a trade-off outside [0, 1], or a TensorDictModule of other keys.

    Examples:
        >>> from uavrl.models import PSAE
        >>> loss = PSAELoss(PSAE(6, features=2))
        >>> data = TensorDict({"observation": torch.rand(5, 6), "previous": {"observation": torch.rand(5, 6)},
        ...     "next": {"observation": torch.rand(5, 6)}}, [5])
        >>> value, metadata = loss.psae_loss(data)
        >>> sorted(metadata), sorted(loss(data).keys())
        (['reconstruction_error', 'similarity'], ['loss_psae', 'reconstruction_error', 'similarity'])
    """

    @dataclass
    class _AcceptedKeys:
        """The keys that the loss reads."""

        observation: NestedKey = "observation"
        previous_observation: NestedKey = ("previous", "observation")
        next_observation: NestedKey = ("next", "observation")
        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_psae", "reconstruction_error", "similarity"]  # noqa: RUF012

    network: TensorDictModuleBase
    network_params: TensorDictParams
    target_network_params: TensorDictParams

    def __init__(self, network: nn.Module, *, tradeoff: float = 0.7, reduction: str = "mean") -> None:
        super().__init__()
        if not 0 <= tradeoff <= 1:
            raise ValueError(f"tradeoff must be in [0, 1], got {tradeoff}.")
        plain = not isinstance(network, TensorDictModuleBase)
        module: Any = TensorDictModule(network, ["observation"], ["features", "reconstruction"]) if plain else network
        in_keys, out_keys = list(module.in_keys), list(module.out_keys)
        if len(in_keys) != 1 or len(out_keys) != 2:
            raise ValueError(
                f"Expected a network from the state to features and reconstruction, got one from {in_keys} to "
                f"{out_keys}."
            )
        self.convert_to_functional(module, "network")
        self.tradeoff = tradeoff
        self.reduction = reduction

    @property
    def in_keys(self) -> list[NestedKey]:
        """The keys that :meth:`forward` reads."""
        keys = self.tensor_keys
        return [keys.previous_observation, keys.observation, keys.next_observation]

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self.set_keys(**dict(zip(("previous_observation", "observation", "next_observation"), values, strict=True)))

    def _forward_value_estimator_keys(self, **kwargs: object) -> None:
        """There is no value estimator."""

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> NoReturn:
        """Not for use.

        Raises:
            UavrlError: always.
        """
        raise UavrlError(
            "PSAELoss compares states and knows no values: make the value estimator of your critic's loss."
        )

    def psae_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Eq. 3.3.

        Args:
            tensordict: ``[*B]`` with the state, the one before and the one after; it is not modified.

        Returns:
            The reduced loss and the mean of both sums, detached.

        Raises:
            ValueError: when the network gives reconstructions of another shape.
        """
        weights = self._maybe_get_priority_weight(tensordict)
        states = torch.stack([tensordict.get(key) for key in self.in_keys])
        data = TensorDict({self.network.in_keys[0]: states}, states.shape[:-1])
        with self.network_params.to_module(self.network, preserve_module_state=False):
            data = self.network(data)
        features, reconstructions = (data.get(key) for key in self.network.out_keys)
        if reconstructions.shape != states.shape:
            got = f"{list(reconstructions.shape)}: check the network"
            raise ValueError(f"Expected reconstructions of the states' shape {list(states.shape)}, got {got}.")
        error = (states - reconstructions).square().sum(-1).sum(0)
        before, anchor, after = features
        similarity = F.cosine_similarity(anchor, before, -1) + F.cosine_similarity(anchor, after, -1)
        metadata = {"reconstruction_error": error.detach().mean(), "similarity": similarity.detach().mean()}
        each = self.tradeoff * error - (1 - self.tradeoff) * similarity
        return self._reduce_loss(each, tensordict=tensordict, weights=weights), metadata

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``loss_psae`` and the mean of its two sums.

        Args:
            tensordict: ``[*B]`` with the state, the one before and the one after.
        """
        loss, metadata = self.psae_loss(tensordict)
        return TensorDict({"loss_psae": loss, **metadata})
