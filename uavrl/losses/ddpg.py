"""DDPG (Lillicrap et al. 2015) as the thesis uses it, on TorchRL's loss."""

from collections.abc import Sequence
from typing import Any, Self

from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.data import Bounded
from torchrl.objectives import DDPGLoss as _DDPGLoss
from torchrl.objectives import ValueEstimators

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.ranges import Discount


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

    num_critics = 1
    actor_network: TensorDictModule
    value_network: TensorDictModule
    actor_network_params: TensorDictParams
    value_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    target_value_network_params: TensorDictParams

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
        super().__init__(
            actor_network,
            value_network,
            loss_function=loss_function,
            delay_actor=True,
            delay_value=True,
            reduction=reduction,
            **kwargs,
        )
        self.out_keys = ["loss_actor", "loss_value", "pred_value", "target_value", "pred_value_max", "target_value_max"]
        self.make_value_estimator(ValueEstimators.TD0, gamma=gamma)

    @classmethod
    def of_networks(
        cls, actor: TensorDictModuleBase, critics: Sequence[TensorDictModule], action_spec: Bounded, **options: Any
    ) -> Self:
        """DDPG has one critic, and asks for no bounds."""
        return cls(actor, critics[0], **options)

    def _set_in_keys(self) -> None:
        """What :meth:`forward` needs: with TorchRL's longer list, selected out-keys take a batch for arguments."""
        flags = (self.tensor_keys.reward, self.tensor_keys.done, self.tensor_keys.terminated)
        following = [unravel_key(("next", key)) for key in (*self.actor_network.in_keys, *flags)]
        self._in_keys = list(dict.fromkeys([*self.actor_network.in_keys, *self.value_network.in_keys, *following]))

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""
        return self.value_network_params

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Eq. 2.8: the squared temporal-difference error.

        Args:
            tensordict: ``[*B]`` with state, action and ``"next"``.

        Returns:
            The reduced loss and metadata, ``td_error`` among them.
        """
        return self.loss_value(tensordict)

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The state with the action μ(s)."""
        acted = tensordict.select(*self.actor_network.in_keys, *self.value_network.in_keys, strict=False)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            return self.actor_network(acted)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """``Q(s, a)``, of a constant critic."""
        critic = self.target_value_network_params if target else self._cached_detached_value_params
        with critic.to_module(self.value_network, preserve_module_state=False):
            value = self.value_network(acted.select(*self.value_network.in_keys))
        return value.get(self.tensor_keys.state_action_value).squeeze(-1)
