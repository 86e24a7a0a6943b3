"""XQC (Palenicek et al. 2026, arXiv 2509.25174): critics that give distributions, with unit-norm weights."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.value.functional import reward2go

from uavrl.errors import UavrlError
from uavrl.losses.crossq import JointBatches
from uavrl.losses.functional import least_valued, project_distribution
from uavrl.losses.sac import SACLoss
from uavrl.losses.td3 import TD3Loss

log = logging.getLogger(__name__)


class _Categorical(JointBatches):
    """Learns distributions of the value by their cross-entropy with those that the targets give."""

    if TYPE_CHECKING:
        target_qvalue_network_params: TensorDictParams

    def __init__(
        self,
        actor_network: TensorDictModuleBase,
        qvalue_network: TensorDictModule | Sequence[TensorDictModule],
        *,
        min_value: float = -5.0,
        max_value: float = 5.0,
        **kwargs: Any,
    ) -> None:
        if not min_value < max_value:
            raise UavrlError(f"min_value must be below max_value, got {min_value} and {max_value}.")
        if "loss_function" in kwargs:
            raise UavrlError("The loss of these critics is the cross-entropy: leave loss_function out.")
        super().__init__(actor_network, qvalue_network, **kwargs)
        self.min_value, self.max_value = min_value, max_value
        self._has_warned = False

    @property
    def critic_tensors(self) -> list[Tensor]:
        """The parameters and statistics of the critics, and the targets, whose statistics the loss moves, too."""
        targets = self.target_qvalue_network_params.values(True, True)
        return [*super().critic_tensors, *(value for value in targets if isinstance(value, Tensor))]

    def support(self, logits: Tensor) -> Tensor:
        """The values ``[N]`` that logits ``[*B, N]`` are of."""
        return torch.linspace(
            self.min_value, self.max_value, logits.shape[-1], dtype=logits.dtype, device=logits.device
        )

    def mean(self, logits: Tensor) -> Tensor:
        """The mean ``[*B]`` of the distributions that logits ``[*B, N]`` give."""
        return logits.softmax(-1) @ self.support(logits)

    def _logits(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
        """Logits ``[K, *B, N]`` of K critics at states and actions ``[*B]``."""
        logits = super()._values(tensordict, params)
        if logits.ndim != tensordict.ndim + 2:
            raise UavrlError(
                f"{type(self).__name__} needs critics that give two logits or more, got one number each: use "
                "uavrl.models.CategoricalCritic."
            )
        return logits

    def _values(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
        """Values ``[K, *B]`` of K critics: the means of their distributions."""
        return self.mean(self._logits(tensordict, params))

    def _cross_entropy(
        self, tensordict: TensorDictBase, following: TensorDictBase, cost: Tensor | float = 0.0
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The reduced cross-entropy with the distribution of ``r + γ (1 - d) (Z'_j(s', a') - cost)``, and metadata.

        Of the target critics, j is the one with the smallest mean.
        """
        logits, _ = self._in_one_batch(self._logits, tensordict, following, self.qvalue_network_params)
        support = self.support(logits)
        with torch.no_grad():
            both = self._in_one_batch(self._logits, tensordict, following, self.target_qvalue_network_params)
            following_values = least_valued(both[1].softmax(-1), support)
            values = self._discounted(tensordict, (support - cost).expand_as(following_values))
            target = project_distribution(following_values, values, support)
        errors = -(target * logits.log_softmax(-1)).sum(-1)
        value, target_value = self.mean(logits.detach()), target @ support.to(target.dtype)
        metadata = {
            "td_error": (value - target_value).square(),
            "next_state_value": following_values @ support,
            "pred_value": value,
            "target_value": target_value,
        }
        return self._reduced(errors.sum(0), tensordict), metadata

    def _discounted(self, tensordict: TensorDictBase, values: Tensor) -> Tensor:
        """The targets ``[*B, N]`` of the values of next states: ``r + γ (1 - d) z'``, over n steps if there are n."""
        keys = self.value_estimator.tensor_keys
        read = (keys.steps_to_next_obs, *(("next", key) for key in (keys.reward, keys.done, keys.terminated)))
        told = tensordict.select(*read, strict=False)
        wide = told.apply(lambda entry: entry.reshape(*told.batch_size, 1).expand_as(values))
        return self.value_estimator.value_estimate(wide, next_value=values)

    @torch.no_grad()
    def observe(self, episodes: TensorDictBase) -> None:
        """Warn once if the discounted rewards of whole new episodes ``[T]`` lie outside the support."""
        super().observe(episodes)
        reward, done = (episodes.get(("next", key), None) for key in (self.tensor_keys.reward, self.tensor_keys.done))
        if self._has_warned or reward is None or done is None:
            return
        returns = reward2go(reward.reshape(-1, 1), done.reshape(-1, 1), float(self.value_estimator.gamma))
        least, most = returns.min().item(), returns.max().item()
        if least < self.min_value or most > self.max_value:
            self._has_warned = True
            log.warning(
                "The discounted rewards of an episode add up to %.4g at the least and %.4g at the most. The critics "
                "know values from %g to %g only (algo.min_value, algo.max_value), and take others for the nearest of "
                "these: widen the range in a new run.",
                least,
                most,
                self.min_value,
                self.max_value,
            )


class XQCLoss(_Categorical, SACLoss):
    """SAC with critics that give a distribution of the value: batch-normalised, with weights of norm 1.

    As in the code of Palenicek et al. (2026), github.com/danielpalenicek/xqc: two critics of
    :class:`~uavrl.models.CategoricalCritic`, each evaluated once at states and next states together, as in CrossQ.
    Unlike CrossQ, it has target networks, which are also evaluated at both, with statistics of the batch. The next
    distribution is that of the target critic with the smaller mean. Reward and entropy bonus shift it, and it is
    projected to the support (C51, Bellemare et al. 2017). The loss is the cross-entropy with it. The actor climbs the
    smaller of the means. After each step of the critics' optimiser, the weights of each unit are scaled to norm 1.

    What differs: the policy's network is as in SAC, while theirs is normalised like the critics. Rewards are not
    divided by the running standard deviation of the return. Instead, set the smallest and the largest value in the unit
    of your rewards. The temperature starts at 1 and the target entropy is minus the action's width; theirs are 0.01
    (``alpha_init``) and half of that width.

    Args:
        actor_network: as in :class:`SACLoss`.
        qvalue_network: as in :class:`SACLoss`, but each critic writes N logits to ``state_action_value``.
        min_value: the smallest value that has a probability, in the unit of rewards; -5 for their normalised rewards.
        max_value: the largest.
        **kwargs: as in :class:`SACLoss`, without ``loss_function``.

    Raises:
        UavrlError: for an empty range of values, a ``loss_function``, or critics that give one number.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.models import CategoricalCritic, GaussianActor
        >>> spec, keys = Bounded(-2.0, 2.0, (4,)), ["observation", "action"]
        >>> critics = [Mod(CategoricalCritic(6, 4, [32]), keys, ["state_action_value"]) for _ in range(2)]
        >>> loss = XQCLoss(XQCLoss.policy_of(GaussianActor(6, 4), spec), critics, action_spec=spec)
        >>> loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[0].shape
        torch.Size([])
        >>> adam = torch.optim.Adam(loss.qvalue_network_params.parameters())
        >>> _ = adam.register_step_post_hook(lambda *_: loss.project_weights())
    """

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The cross-entropy with the distribution of ``r + γ (1 - d) (Z'_j(s', a') - α log π(a'|s'))``, reduced."""
        following, log_prob = self._acted_next(tensordict)
        return self._cross_entropy(tensordict, following, self._alpha * log_prob.unsqueeze(-1))


class XQCTD3Loss(_Categorical, TD3Loss):
    """TD3 with the critics of :class:`XQCLoss`, a deterministic actor and noise on the target actor's next action.

    It is not in the paper.

    Args:
        actor_network: as in :class:`TD3Loss`.
        qvalue_network: as in :class:`XQCLoss`.
        min_value: as in :class:`XQCLoss`.
        max_value: as in :class:`XQCLoss`.
        **kwargs: as in :class:`TD3Loss`, without ``loss_function``.

    Raises:
        UavrlError: as :class:`XQCLoss`.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.models import Actor, CategoricalCritic
        >>> spec, keys = Bounded(-2.0, 2.0, (4,)), ["observation", "action"]
        >>> critics = [Mod(CategoricalCritic(6, 4, [32]), keys, ["state_action_value"]) for _ in range(2)]
        >>> loss = XQCTD3Loss(Mod(Actor(6, 4), ["observation"], ["action"]), critics, action_spec=spec)
        >>> loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[0].shape
        torch.Size([])
    """

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The cross-entropy with the distribution of ``r + γ (1 - d) Z'_j(s', a')``, reduced."""
        return self._cross_entropy(tensordict, self._acted_next(tensordict))

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The mean ``[*B]`` of the first critic's distribution, or its target's, which get no gradients."""
        return self.mean(super().action_value(acted, target=target))
