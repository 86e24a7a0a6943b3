"""TD3 (Fujimoto et al. 2018) as the thesis uses it, on TorchRL's loss."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.data import Bounded
from torchrl.envs.utils import step_mdp
from torchrl.objectives import TD3Loss as _TD3Loss
from torchrl.objectives import ValueEstimators
from torchrl.objectives.utils import distance_loss

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.critics import is_stackable, several, stacked_values
from uavrl_onboard.ranges import Count, Discount, NonNegative


class TD3Loss(ActorCriticLoss, _TD3Loss):
    """TD3's critic and actor losses (Chansuparp (2022), Eq. 2.10–2.13).

    What differs from :class:`torchrl.objectives.TD3Loss`: the squared error is the default, target noise
    and clip are stated for unit actions and scaled by half the action's range, critics keep the weights
    they come with and may read what the actor does not, and the actor's loss evaluates the first critic only.

    Args:
        actor_network: reads the state, writes ``action``.
        qvalue_network: a list of critics, or one critic, of which the others are copies with weights of their own; each
            reads the state and ``action``, writes ``state_action_value``.
        action_spec: the bounded spec of one action; in place of it ``bounds=(low, high)``.
        num_qvalue_nets: how many critics.
        gamma: discount γ.
        policy_noise: σ of Eq. 2.10, for unit actions.
        noise_clip: c of Eq. 2.10, for unit actions.
        loss_function: ``"l2"`` (Eq. 2.12), ``"l1"`` or ``"smooth_l1"``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        **kwargs: as in :class:`torchrl.objectives.TD3Loss`.

    Raises:
        ValueError: for a list of another number of critics.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.models import Actor, Critic
        >>> spec = Bounded(-2.0, 2.0, (4,))
        >>> critics = [Mod(Critic(6, 4), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
        >>> loss = TD3Loss(Mod(Actor(6, 4), ["observation"], ["action"]), critics, action_spec=spec)
        >>> loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[0].shape
        torch.Size([])
    """

    critics_may_differ = True

    def __init__(
        self,
        actor_network: TensorDictModule,
        qvalue_network: TensorDictModule | Sequence[TensorDictModule],
        *,
        action_spec: Bounded | None = None,
        num_qvalue_nets: Count = 2,
        gamma: Discount = 0.99,
        policy_noise: NonNegative = 0.2,
        noise_clip: NonNegative = 0.5,
        loss_function: str = "l2",
        reduction: str = "mean",
        **kwargs: Any,
    ) -> None:
        kwargs |= {"loss_function": loss_function, "reduction": reduction, "num_qvalue_nets": num_qvalue_nets}
        super().__init__(actor_network, several(qvalue_network, num_qvalue_nets), action_spec=action_spec, **kwargs)
        values = ["pred_value", "state_action_value_actor", "next_state_value", "target_value"]
        self.out_keys = ["loss_actor", "loss_qvalue", *values]
        half_range = (self.max_action - self.min_action) / 2
        del self.policy_noise, self.noise_clip
        self.register_buffer("policy_noise", policy_noise * half_range)
        self.register_buffer("noise_clip", noise_clip * half_range)
        self.make_value_estimator(ValueEstimators.TD0, gamma=gamma)

    def _make_vmap(self) -> None:
        super()._make_vmap()
        if is_stackable(self.qvalue_network):
            self._vmap_qvalue_network00 = partial(stacked_values, self.qvalue_network, repeated=True)

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        keys: list[NestedKey] = list(self.in_keys)
        following = {unravel_key(("next", key)) for key in self._read_by_critics}
        self._in_keys = [*keys, *sorted(following - set(keys), key=str)]

    @property
    def _read_by_critics(self) -> list[NestedKey]:
        """What the critics read of a state."""
        return [key for key in self.qvalue_network.in_keys if key != self.tensor_keys.action]

    def _values(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
        """Values ``[K, *B]`` of K critics at states and actions ``[*B]``."""
        inputs = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        values = self._vmap_qvalue_network00(inputs.expand(self.num_qvalue_nets, *inputs.batch_size), params)
        return values.get(self.tensor_keys.state_action_value).squeeze(-1)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The error of all critics against ``r + γ (1 - d) min_j Q'_j(s', a')`` (Eq. 2.10–2.12), reduced.

        As TorchRL computes it; here, critics may read more of the next state than the actor does.
        """
        with torch.no_grad():
            next_value = self._values(self._acted_next(tensordict), self.target_qvalue_network_params)
        return self._compared(tensordict, self._values(tensordict, self.qvalue_network_params), next_value)

    @torch.no_grad()
    def _acted_next(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The next states ``[*B]`` with the target actor's noisy actions (Eq. 2.10)."""
        action = tensordict.get(self.tensor_keys.action)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(-self.noise_clip, self.noise_clip)
        following = step_mdp(tensordict).select(*self.actor_network.in_keys, *self._read_by_critics, strict=False)
        with self.target_actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            following = self.actor_network(following)
        noisy = (following.get(self.tensor_keys.action) + noise).clamp(self.min_action, self.max_action)
        return following.set(self.tensor_keys.action, noisy)

    def _compared(
        self, tensordict: TensorDictBase, value: Tensor, next_values: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The reduced error of values ``[K, *B]`` against the target of the smallest next ones, and metadata."""
        next_value = next_values.amin(0)
        told = tensordict.copy().set(("next", self.tensor_keys.state_action_value), next_value.unsqueeze(-1))
        target = self.value_estimator.value_estimate(told).squeeze(-1)
        errors = distance_loss(value, target.expand_as(value), loss_function=self.loss_function).sum(0)
        metadata = {
            "td_error": (value - target).pow(2),
            "next_state_value": next_value.detach(),
            "pred_value": value.detach(),
            "target_value": target.detach(),
        }
        return self._reduced(errors, tensordict), metadata
