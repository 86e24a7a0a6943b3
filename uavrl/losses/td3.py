"""TD3 (Fujimoto et al. 2018) as the thesis uses it, on TorchRL's loss."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from tensordict.nn import TensorDictModule
from torchrl.data import Bounded
from torchrl.objectives import TD3Loss as _TD3Loss
from torchrl.objectives import ValueEstimators

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.critics import is_stackable, several, stacked_values
from uavrl_onboard.ranges import Count, Discount, NonNegative


class TD3Loss(ActorCriticLoss, _TD3Loss):
    """TD3's critic and actor losses (Chansuparp (2022), Eq. 2.10–2.13).

    What differs from :class:`torchrl.objectives.TD3Loss`: the squared error is the default, target noise
    and clip are stated for unit actions and scaled by half the action's range, critics keep the weights
    they come with, and the actor's loss evaluates the first critic only.

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
