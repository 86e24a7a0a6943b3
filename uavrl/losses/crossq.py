"""CrossQ (Bhatt et al. 2024, arXiv 1902.05605): critics with batch normalisation and without targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.critics import in_mode
from uavrl.losses.sac import SACLoss
from uavrl.losses.td3 import TD3Loss

Evaluate = Callable[[TensorDictBase, TensorDictBase], Tensor]  # critics with these parameters, at states and actions

if TYPE_CHECKING:
    _Base = ActorCriticLoss
else:
    _Base = object


class JointBatches(_Base):
    """Evaluates critics at states and next states in one batch, so that one set of statistics normalises both."""

    critics_may_differ: ClassVar[bool] = False
    if TYPE_CHECKING:
        training: bool
        qvalue_network: TensorDictModule
        qvalue_network_params: TensorDictParams

        def _values(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
            """Values ``[K, *B]`` of K critics."""
            raise NotImplementedError

    def _in_one_batch(
        self, evaluate: Evaluate, tensordict: TensorDictBase, following: TensorDictBase, params: TensorDictBase
    ) -> tuple[Tensor, Tensor]:
        """What ``evaluate`` gives at states and at next states, ``[K, *B, ...]``; in training mode, statistics move."""
        read = self.qvalue_network.in_keys
        both = torch.cat([tensordict.select(*read), following.select(*read)])
        with in_mode(self.qvalue_network, training=self.training):
            now, then = evaluate(both, params).chunk(2, 1)
        return now, then

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The value ``[*B]`` of states and actions by constant critics and their running statistics."""
        with in_mode(self.qvalue_network, training=False):
            return super().action_value(acted, target=target)


class _WithoutTargets(JointBatches):
    """Takes the values of next states from the critics themselves."""

    has_targets: ClassVar[bool] = False

    def __init__(
        self,
        actor_network: TensorDictModuleBase,
        qvalue_network: TensorDictModule | Sequence[TensorDictModule],
        **kwargs: Any,
    ) -> None:
        super().__init__(actor_network, qvalue_network, delay_actor=False, delay_qvalue=False, **kwargs)

    def _both_values(self, tensordict: TensorDictBase, following: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Values ``[K, *B]`` at states and at next states, the latter constant."""
        value, next_value = self._in_one_batch(self._values, tensordict, following, self.qvalue_network_params)
        return value, next_value.detach()


class CrossQLoss(_WithoutTargets, SACLoss):
    """SAC without target critics: batch normalisation over states and next states together keeps critics stable.

    What differs from :class:`torchrl.objectives.CrossQLoss`: the squared error is the default, critics keep the weights
    they come with, and the interface is that of :class:`SACLoss`. Its critics normalise their batches, as
    :class:`~uavrl.models.BatchRenormCritic` does; others learn without targets as well, and diverge easily.

    Args:
        actor_network: as in :class:`SACLoss`.
        qvalue_network: as in :class:`SACLoss`.
        **kwargs: as in :class:`SACLoss`.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.models import BatchRenormCritic, GaussianActor
        >>> spec, keys = Bounded(-2.0, 2.0, (4,)), ["observation", "action"]
        >>> critics = [Mod(BatchRenormCritic(6, 4, [32]), keys, ["state_action_value"]) for _ in range(2)]
        >>> loss = CrossQLoss(CrossQLoss.policy_of(GaussianActor(6, 4), spec), critics, action_spec=spec)
        >>> loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[0].shape
        torch.Size([])
    """

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The error of all critics against ``r + γ (1 - d) (min_j Q_j(s', a') - α log π(a'|s'))``, reduced.

        The critics are evaluated once, at states and next states.
        """
        following, log_prob = self._acted_next(tensordict)
        value, next_value = self._both_values(tensordict, following)
        soft = next_value.amin(0) - self._alpha * log_prob
        target = self.value_estimator.value_estimate(tensordict, next_value=soft.unsqueeze(-1)).squeeze(-1)
        return self._compared(tensordict, value, target)


class CrossQTD3Loss(_WithoutTargets, TD3Loss):
    """TD3 without targets: as :class:`CrossQLoss`, with a deterministic actor and noise on the next action.

    Args:
        actor_network: as in :class:`TD3Loss`.
        qvalue_network: as in :class:`TD3Loss`.
        **kwargs: as in :class:`TD3Loss`.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.models import Actor, BatchRenormCritic
        >>> spec, keys = Bounded(-2.0, 2.0, (4,)), ["observation", "action"]
        >>> critics = [Mod(BatchRenormCritic(6, 4, [32]), keys, ["state_action_value"]) for _ in range(2)]
        >>> loss = CrossQTD3Loss(Mod(Actor(6, 4), ["observation"], ["action"]), critics, action_spec=spec)
        >>> loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[0].shape
        torch.Size([])
    """

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The error of all critics against ``r + γ (1 - d) min_j Q_j(s', a')``, reduced.

        The critics are evaluated once, at states and next states.
        """
        return self._compared(tensordict, *self._both_values(tensordict, self._acted_next(tensordict)))
