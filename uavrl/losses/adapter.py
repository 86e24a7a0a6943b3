"""How actor penalties read TorchRL's own losses: the actor's action, and the value of an action."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules.distributions.utils import rsample_and_log_prob
from torchrl.objectives import LossModule, REDQLoss

from uavrl.errors import UavrlError
from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.critics import in_mode, project_weights

_LOG_PROB = "_log_prob"  # where the log-probability of a sampled action is kept
_CRITICS = (
    "qvalue_network",
    "value_network",
)  # TorchRL's names; SAC's first form has both, and the first takes actions


def adapted(loss: LossModule) -> ActorCriticLoss | TorchRLLoss:
    """Return the loss itself if it has the interface that penalties need, else the loss behind an adapter.

    Raises:
        UavrlError: for a loss without an actor and a critic of its actions.

    Examples:
        >>> from torchrl.modules import QValueActor
        >>> from torchrl.objectives import DQNLoss
        >>> network = QValueActor(nn.Linear(3, 2), in_keys=["observation"], action_space="one-hot")
        >>> adapted(DQNLoss(network, action_space="one-hot"))
        Traceback (most recent call last):
        uavrl_onboard.errors.UavrlError: An actor penalty needs a loss that has an actor and a critic of the ...
    """
    return loss if isinstance(loss, ActorCriticLoss) else TorchRLLoss(loss)


def action_key(loss: LossModule) -> NestedKey | None:
    """Return the entry that the loss's actor writes and its critic reads; None without one."""
    actor, critic = _network(loss, "actor_network"), _critic(loss)
    if actor is None or critic is None:
        return None
    read = {unravel_key(key) for key in critic.in_keys}
    named = getattr(loss.tensor_keys, "action", None)
    if isinstance(named, str | tuple) and unravel_key(named) in read:
        return named
    return next((key for key in reversed(actor.out_keys) if unravel_key(key) in read), None)


def _network(loss: LossModule, name: str) -> TensorDictModuleBase | None:
    network = getattr(loss, name, None)
    return network if hasattr(network, "in_keys") else None


def _critic(loss: LossModule) -> TensorDictModuleBase | None:
    names = (loss.critic_name,) if isinstance(loss, ActorCriticLoss) else _CRITICS
    return next((critic for name in names if (critic := _network(loss, name)) is not None), None)


class TorchRLLoss:
    """An actor–critic loss of TorchRL, or a subclass of one, with the methods that actor penalties call.

    The actor's own loss is whatever the class computes. Penalties need the differentiable action and Q(s, a) besides,
    which come from the networks. A loss with a temperature samples its actions by reparameterisation, as SAC, REDQ and
    CrossQ do; any other actor is called as it is. Q is what the actor of the class climbs: the mean of REDQ's critics,
    the smallest of the critics of other losses with a temperature, and else the first critic.

    Args:
        loss: a loss with ``actor_network`` and ``qvalue_network``, or ``value_network`` that reads the action.

    Raises:
        UavrlError: for another loss.
    """

    def __init__(self, loss: LossModule) -> None:
        action = action_key(loss) if isinstance(loss, LossModule) else None
        if action is None:
            raise UavrlError(
                "An actor penalty needs a loss that has an actor and a critic of the actor's actions, such as TD3Loss, "
                f"DDPGLoss, SACLoss, REDQLoss or CrossQLoss, and {type(loss).__name__} is none."
            )
        self.unwrapped = loss
        self.action_key: NestedKey = action
        self.critic_name = next(name for name in _CRITICS if _network(loss, name) is not None)
        self.samples = hasattr(loss, "log_alpha")
        self.penalties: list[ActorCriticLoss] = []

    @property
    def in_keys(self) -> list[NestedKey]:
        """The entries that the class needs; TorchRL lists three more, with which out-keys could not be selected."""
        keys = self.unwrapped.tensor_keys
        spare = {getattr(keys, name, None) for name in ("priority_weight", "sample_log_prob")}
        spare.add(unravel_key(("next", self.action_key)))
        return [key for key in self.unwrapped.in_keys if key not in spare]

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""
        return getattr(self.unwrapped, f"{self.critic_name}_params")

    @property
    def critic_tensors(self) -> list[Tensor]:
        """The parameters that the critic's optimiser moves, and the buffers beside them."""
        return [value for value in self.critic_network_params.values(True, True) if isinstance(value, Tensor)]

    def project_weights(self) -> None:
        """As :meth:`uavrl.losses.ActorCriticLoss.project_weights`."""
        project_weights(getattr(self.unwrapped, self.critic_name), self.critic_network_params)

    @property
    def alpha_params(self) -> list[Tensor]:
        """The logarithm of the temperature, if it is trained."""
        log_alpha = getattr(self.unwrapped, "log_alpha", None)
        return [log_alpha] if isinstance(log_alpha, nn.Parameter) else []

    def _accepted_keys(self) -> set[str]:
        return set(self.unwrapped._AcceptedKeys.__dataclass_fields__)

    def observe(self, episodes: TensorDictBase) -> None:
        """Does nothing: TorchRL's losses learn from batches alone."""

    def diagnostics(self) -> dict[str, float]:
        """There are none."""
        return {}

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """States ``[*B]`` with the current actor's actions, differentiable in the actor; the input is not modified.

        Raises:
            UavrlError: if a sampled action has no gradient.
        """
        loss, actor, critic = self.unwrapped, self.unwrapped.actor_network, getattr(self.unwrapped, self.critic_name)
        acted = tensordict.select(*actor.in_keys, *critic.in_keys, strict=False)
        mode = ExplorationType.RANDOM if self.samples else loss.deterministic_sampling_mode
        with set_exploration_type(mode), loss.actor_network_params.to_module(actor, preserve_module_state=False):
            if not self.samples:
                return actor(acted)
            distribution = actor.get_dist(acted)
            if not distribution.has_rsample:
                raise UavrlError(
                    f"An actor penalty needs actions with a gradient, and those of {type(distribution).__name__} have "
                    "none: use a distribution that is reparameterised, such as TanhNormal."
                )
            action, log_prob = rsample_and_log_prob(distribution)
        return acted.set(self.action_key, action).set(_LOG_PROB, log_prob)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The value ``[*B]`` of states and actions by constant critics, or by the target critics."""
        loss, critic = self.unwrapped, getattr(self.unwrapped, self.critic_name)
        params = getattr(loss, f"target_{self.critic_name}_params") if target else self.critic_network_params.detach()
        every = params.unbind(0) if params.batch_dims else (params,)
        inputs = acted.select(*critic.in_keys)
        with in_mode(critic, training=False):
            values = torch.stack([self._value(critic, one, inputs) for one in (every if self.samples else every[:1])])
        if isinstance(loss, REDQLoss):
            return values.mean(0)
        return values.amin(0)

    def _value(self, critic: TensorDictModule, params: TensorDictBase, inputs: TensorDictBase) -> Tensor:
        """One critic's value ``[*B]``; the mean of its quantiles where it has some."""
        with params.to_module(critic, preserve_module_state=False):
            return critic(inputs.copy()).get(self.unwrapped.tensor_keys.state_action_value).mean(-1)

    @torch.no_grad()
    def actor_objective(self, acted: TensorDictBase) -> Tensor:
        """``-Q(s, a)``, or ``α log π(a|s) - Q(s, a)`` ``[*B]``, constant: its size scales the relative terms."""
        value = self.action_value(acted)
        return self.unwrapped.log_alpha.exp() * acted.get(_LOG_PROB) - value if self.samples else -value

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The actor's reduced loss as the class computes it, and metadata."""
        for name in ("actor_loss", "loss_actor"):  # TD3, SAC and CrossQ, or DDPG
            if (method := getattr(self.unwrapped, name, None)) is not None:
                return method(tensordict.copy())  # SAC writes into what it reads
        return self.unwrapped(tensordict.copy()).get("loss_actor"), {}  # REDQ computes all at once

    def reduced(self, errors: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Reduces errors ``[*B]`` as the class reduces the actor's objective."""
        loss = self.unwrapped
        weighted = hasattr(loss.tensor_keys, "priority_weight")
        weights = loss._maybe_get_priority_weight(tensordict) if weighted else None
        if isinstance(loss, REDQLoss):  # which has an objective for each critic
            errors, tensordict = errors.expand(loss.num_qvalue_nets, *errors.shape), tensordict.unsqueeze(0)
        how = getattr(loss, "reduction", "mean")
        return loss._reduce_loss(errors, tensordict=tensordict, weights=weights, reduction=how)
