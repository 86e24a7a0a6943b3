"""DDPG (Lillicrap et al. 2015) as the thesis uses it, on TorchRL's loss."""

from collections.abc import Sequence
from typing import Any, Self

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.data import Bounded
from torchrl.objectives import DDPGLoss as _DDPGLoss
from torchrl.objectives import ValueEstimators

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl_onboard.ranges import Discount


class DDPGLoss(ActorCriticLoss, _DDPGLoss):
    """DDPG's critic and actor losses (Chansuparp (2022), Eq. 2.7–2.8), with target actor and target critic.

    Args:
        actor_network: reads the state, writes ``action``.
        value_network: the critic; reads the state and ``action``, writes ``state_action_value``.
        gamma: discount γ.
        loss_function: ``"l2"`` (Eq. 2.8), ``"l1"`` or ``"smooth_l1"``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        **kwargs: as in :class:`torchrl.objectives.DDPGLoss`.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from uavrl.models import Actor, Critic
        >>> critic = Mod(Critic(6, 4), ["observation", "action"], ["state_action_value"])
        >>> loss = DDPGLoss(Mod(Actor(6, 4), ["observation"], ["action"]), critic)
        >>> loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[0].shape
        torch.Size([])
    """

    critic_name, num_critics = "value_network", 1

    def __init__(
        self,
        actor_network: TensorDictModule,
        value_network: TensorDictModule,
        *,
        gamma: Discount = 0.99,
        loss_function: str = "l2",
        reduction: str = "mean",
        **kwargs: Any,
    ) -> None:
        kwargs = {"delay_actor": True, "delay_value": True} | kwargs
        super().__init__(actor_network, value_network, loss_function=loss_function, reduction=reduction, **kwargs)
        self.out_keys = ["loss_actor", "loss_value", "pred_value", "target_value", "pred_value_max", "target_value_max"]
        self.make_value_estimator(ValueEstimators.TD0, gamma=gamma)

    @classmethod
    def of_networks(
        cls, actor: TensorDictModuleBase, critics: Sequence[TensorDictModule], action_spec: Bounded, **options: Any
    ) -> Self:
        """The loss of a policy and one critic; it needs no bounds."""
        return cls(actor, critics[0], **options)

    def _set_in_keys(self) -> None:
        """Lists what :meth:`forward` reads: with TorchRL's longer list a selection of out-keys breaks its dispatch."""
        flags = (self.tensor_keys.reward, self.tensor_keys.done, self.tensor_keys.terminated)
        following = [unravel_key(("next", key)) for key in (*self.actor_network.in_keys, *flags)]
        self._in_keys = list(dict.fromkeys([*self.actor_network.in_keys, *self.value_network.in_keys, *following]))

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The critic's reduced loss (Eq. 2.8) on transitions ``[*B]``, and metadata, ``td_error`` among them."""
        return self.loss_value(tensordict)
