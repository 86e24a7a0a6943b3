"""SAC (Haarnoja et al. 2018, arXiv 1812.05905) behind the interface of the other losses, on TorchRL's loss."""

from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded, TensorSpec
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.modules.distributions.utils import rsample_and_log_prob, sample_and_log_prob
from torchrl.objectives import SACLoss as _SACLoss
from torchrl.objectives import ValueEstimators
from torchrl.objectives.utils import distance_loss

from uavrl.errors import UavrlError
from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.critics import is_stackable, several, stacked_values
from uavrl_onboard.ranges import Count, Discount


class SACLoss(ActorCriticLoss, _SACLoss):
    """SAC's critic, actor and temperature losses, in the form without a state-value network.

    What differs from :class:`torchrl.objectives.SACLoss`: the squared error is the default, critics keep the weights
    they come with, and :meth:`value_loss` is the critics' loss, with the metadata of :class:`TD3Loss`.

    Args:
        actor_network: reads the state, samples ``action`` by reparameterisation and gives its log-probability.
        qvalue_network: a list of critics, or one critic, of which the others are copies with weights of their own; each
            reads the state and ``action``, writes ``state_action_value``.
        value_network: None: this is the form without one.
        action_spec: the spec of one action, for the target entropy; None: that of the actor, if it has one.
        num_qvalue_nets: how many critics.
        gamma: discount γ.
        target_entropy: the entropy of the policy to which the temperature leads; ``"auto"``: minus the action's width.
        loss_function: ``"l2"``, ``"l1"`` or ``"smooth_l1"``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        **kwargs: as in :class:`torchrl.objectives.SACLoss`.

    Raises:
        ValueError: for a list of another number of critics, or a state-value network.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.models import Critic, GaussianActor
        >>> spec = Bounded(-2.0, 2.0, (4,))
        >>> critics = [Mod(Critic(6, 4), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
        >>> loss = SACLoss(SACLoss.policy_of(GaussianActor(6, 4), spec), critics, action_spec=spec)
        >>> actor_loss, metadata = loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))
        >>> loss.alpha_loss(metadata["log_prob"]).shape
        torch.Size([])
    """

    critics_may_differ = True

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        qvalue_network: TensorDictModule | Sequence[TensorDictModule],
        value_network: TensorDictModule | None = None,
        *,
        action_spec: TensorSpec | None = None,
        num_qvalue_nets: Count = 2,
        gamma: Discount = 0.99,
        target_entropy: float | Literal["auto"] = "auto",
        loss_function: str = "l2",
        reduction: str = "mean",
        **kwargs: Any,
    ) -> None:
        if value_network is not None:
            raise UavrlError(
                "uavrl's SACLoss is the form without a state-value network, got one: leave value_network out, or use "
                "torchrl.objectives.SACLoss."
            )
        kwargs.setdefault("scalar_output_mode", "exclude" if reduction == "none" else None)
        kwargs |= {"target_entropy": target_entropy, "loss_function": loss_function, "reduction": reduction}
        critics = several(qvalue_network, num_qvalue_nets)
        super().__init__(actor_network, critics, action_spec=action_spec, num_qvalue_nets=num_qvalue_nets, **kwargs)
        self.out_keys = ["loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy"]
        _ = self.target_entropy  # makes it a buffer now, so that state dicts have it also below an actor penalty
        self.make_value_estimator(ValueEstimators.TD0, gamma=gamma)

    @classmethod
    def policy_of(
        cls, network: nn.Module, action_spec: Bounded, in_keys: Sequence[str] = ("observation",)
    ) -> TensorDictModuleBase:
        """A policy that samples: the network gives mean and deviation of a normal, squashed to the bounds."""
        return ProbabilisticActor(
            TensorDictModule(network, in_keys=list(in_keys), out_keys=["loc", "scale"]),
            in_keys=["loc", "scale"],
            spec=action_spec,
            distribution_class=TanhNormal,
            distribution_kwargs={"low": action_spec.space.low[0].item(), "high": action_spec.space.high[0].item()},
            return_log_prob=True,
        )

    def _make_vmap(self) -> None:
        super()._make_vmap()
        if is_stackable(self.qvalue_network):
            self._vmap_qnetworkN0 = partial(stacked_values, self.qvalue_network)

    def _values(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
        """Values ``[K, *B]`` of K critics at states and actions ``[*B]``."""
        inputs = tensordict.select(*self.qvalue_network.in_keys)
        return self._vmap_qnetworkN0(inputs, params).get(self.tensor_keys.state_action_value).squeeze(-1)

    @torch.no_grad()
    def _acted_next(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, Tensor]:
        """The next states ``[*B]`` with sampled actions, and the logarithms of their probabilities."""
        read = (*self.actor_network.in_keys, *self.qvalue_network.in_keys)
        following = tensordict.get("next").select(*read, strict=False)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            action, log_prob = sample_and_log_prob(self.actor_network.get_dist(following))
        return following.set(self.tensor_keys.action, action), log_prob

    @property
    def alpha_params(self) -> list[Tensor]:
        """The logarithm of the temperature; none if the temperature is fixed."""
        return [self.log_alpha] if isinstance(self.log_alpha, nn.Parameter) else []

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The squared error of all critics against ``r + γ (1 - d) (min_j Q'_j(s', a') - α log π(a'|s'))``, reduced.

        The metadata of transitions ``[*B]`` are detached, ``td_error`` (squared, ``[K, *B]``) among them.
        """
        target = self._compute_target_v2(tensordict)
        return self._compared(tensordict, self._values(tensordict, self.qvalue_network_params), target)

    def _compared(self, tensordict: TensorDictBase, value: Tensor, target: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The reduced error of values ``[K, *B]`` against targets ``[*B]``, and metadata."""
        errors = distance_loss(value, target.expand_as(value), loss_function=self.loss_function).sum(0)
        metadata = {"td_error": (value - target).square(), "pred_value": value, "target_value": target}
        return self._reduced(errors, tensordict), {name: number.detach() for name, number in metadata.items()}

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """TorchRL's name of :meth:`value_loss`; its ``td_error`` is the larger of the absolute errors."""
        loss, metadata = self.value_loss(tensordict)
        return loss, {"td_error": metadata["td_error"].sqrt().amax(0)}

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The state with a sampled action, differentiable in the actor, and its log-probability."""
        acted = self._actor_inputs(tensordict)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            action, log_prob = rsample_and_log_prob(self.actor_network.get_dist(acted))
        return acted.set(self.tensor_keys.action, action).set(self.tensor_keys.log_prob, log_prob)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """``min_j Q_j(s, a)``, of constant critics."""
        return self._values(acted, self._constant_critics(target)).amin(0)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """What the actor minimises for each sample ``[*B]``: ``α log π(a|s) - min_j Q_j(s, a)``, and metadata."""
        objective, metadata = super().actor_objective(acted, target=target)
        log_prob = acted.get(self.tensor_keys.log_prob)
        return self._alpha * log_prob + objective, metadata | {"log_prob": log_prob.detach()}

    def alpha_loss(self, log_prob: Tensor) -> Tensor:
        """The temperature's reduced loss: ``-log α (log π + target entropy)``."""
        return self._reduce_loss(self._alpha_loss(log_prob.detach()))
