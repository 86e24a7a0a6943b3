"""FORK, the forward-looking actor (Wei & Ying (2020), arXiv 2010.01652), for any actor–critic loss."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

from uavrl.entries import after_step
from uavrl.losses.actor_penalty import ActorPenalty, AuxiliaryModel
from uavrl.losses.functional import check_episodes, clamped_smooth_l1, episode_returns, fork_objective, fork_weight
from uavrl.losses.model_gate import ModelGate
from uavrl_onboard.ranges import Count, Discount, NonNegative, Positive


class Fork(ActorPenalty):
    """Lets the actor look two predicted steps ahead (Chansuparp (2022), Eq. 2.14).

    A system network f predicts the next state, a reward network g the reward. The term
    ``-w [g(s, s1, μ(s)) + γ g(s1, s2, μ(s1)) + γ² Q(s2, μ(s2))]`` with ``s1 = f(s, μ(s))`` and ``s2 = f(s1, μ(s1))`` is
    added to the actor's objective while the last system loss is under ``threshold``. The weight falls as returns rise:
    ``w = base_weight (1 - clip(mean of the last returns / max_reward, 0, 1))``.

    A variant is a subclass with its own :meth:`look_ahead` (the term), :meth:`system_errors` (the system network's
    error) or :attr:`predicts_rewards`.

    Args:
        base: the loss to add the term to, or another actor penalty. Its actor reads one key, the state.
        system_network: takes state and ``action`` to the next state, such as :class:`uavrl.models.SystemNet`.
        reward_network: takes state, next state and ``action`` to the reward ``[*B, 1]``, such as
            :class:`uavrl.models.RewardNet`; None where a variant predicts no rewards.
        observations: width of the state.
        max_reward: return at which the weight is 0.
        gamma: discount γ of the predicted steps.
        base_weight: the weight at returns of 0 and below.
        threshold: the term is active while the system loss is below this.
        return_window: how many of the last returns are averaged.
        backprop_through_model: let the actor's gradient flow through predicted states; the authors detach them.
        clamp: clamp predicted states to the range observed so far, each dimension by itself.
        model_lr: Adam's step for both networks.

    Raises:
        ValueError: for a reward network too many or too few, or several state keys.

    Examples:
        >>> from torchrl.data import Bounded
        >>> from uavrl.losses import TD3Loss
        >>> from uavrl.models import Actor, Critic, RewardNet, SystemNet
        >>> critics = [
        ...     TensorDictModule(Critic(6, 2), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
        >>> actor = TensorDictModule(Actor(6, 2), ["observation"], ["action"])
        >>> td3 = TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (2,)))
        >>> loss = Fork(
        ...     td3, system_network=SystemNet(6, 2), reward_network=RewardNet(6, 2), observations=6, max_reward=500.0)
        >>> loss.update_gate(0.01)
        >>> loss.active, loss.diagnostics()["fork_gate"]
        (True, 1.0)
    """

    @dataclass
    class _AcceptedKeys(ActorPenalty._AcceptedKeys):
        """The keys that FORK reads of a transition; by default ``observation`` and ``action`` are the actor's.

        If TorchRL's ``RewardSum`` has written ``episode_reward`` under ``"next"``, :meth:`observe` takes the returns
        from there: they are not changed by a transform that comes after it.
        """

        observation: NestedKey = "observation"
        action: NestedKey = "action"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        episode_reward: NestedKey = "episode_reward"

    default_keys = _AcceptedKeys
    computed: ClassVar[Mapping[str, str]] = {"weight": "base_weight, max_reward and the returns"}

    predicts_rewards: ClassVar[bool] = True
    """Whether there is a reward network."""

    system_network: TensorDictModuleBase
    system_network_params: TensorDictParams
    target_system_network_params: TensorDictParams
    reward_network: TensorDictModuleBase
    reward_network_params: TensorDictParams
    target_reward_network_params: TensorDictParams
    weight: Tensor
    observed_low: Tensor
    observed_high: Tensor

    def __init__(
        self,
        base: LossModule,
        *,
        system_network: nn.Module,
        reward_network: nn.Module | None = None,
        observations: int,
        max_reward: Positive,
        gamma: Discount = 0.99,
        base_weight: NonNegative = 0.6,
        threshold: Positive = 0.020,
        return_window: Count = 100,
        backprop_through_model: bool = False,
        clamp: bool = True,
        model_lr: Positive = 3e-4,
    ) -> None:
        if (reward_network is None) == self.predicts_rewards:
            wanted, got = ("a", "none") if self.predicts_rewards else ("no", "one")
            raise ValueError(f"{type(self).__name__} expected {wanted} reward_network, got {got}.")
        super().__init__(base)
        if len(states := self.unwrapped.actor_network.in_keys) != 1:
            raise ValueError(
                f"Fork expected an actor that reads one key, the state, got {states}: concatenate them first."
            )
        self._wrapped: list[str] = []  # networks that came without keys
        self._model_names = ["system", "reward"] if self.predicts_rewards else ["system"]
        self._add_network("system_network", system_network, ("next", self.tensor_keys.observation))
        if reward_network is not None:
            self._add_network("reward_network", reward_network, ("next", self.tensor_keys.reward))
        self.gamma, self.max_reward, self.base_weight = gamma, max_reward, base_weight
        self.backprop_through_model, self.clamp, self.model_lr = backprop_through_model, clamp, model_lr
        device = self.system_network_params.device or next(self.parameters()).device
        self.register_buffer("weight", torch.tensor(float(base_weight), device=device))
        self.register_buffer("observed_low", torch.full((observations,), -math.inf, device=device))
        self.register_buffer("observed_high", torch.full((observations,), math.inf, device=device))
        self.returns: deque[float] = deque(maxlen=return_window)
        self.out_keys = [*self.out_keys, *(f"loss_{name}" for name in self._model_names)]
        self.gate = ModelGate(threshold, device)

    def _add_network(self, name: str, network: nn.Module, out_key: NestedKey) -> None:
        if not isinstance(network, TensorDictModuleBase):
            network = TensorDictModule(network, self._read_by(name), [unravel_key(out_key)])
            self._wrapped.append(name)
        self.convert_to_functional(network, name)

    def _read_by(self, name: str) -> list[NestedKey]:
        state, action = self.tensor_keys.observation, self.tensor_keys.action
        return [state, action] if name == "system_network" else [state, unravel_key(("next", state)), action]

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """As :meth:`ActorPenalty.set_keys`; networks that came without keys read the new ones."""
        super().set_keys(**kwargs)
        for name in self._wrapped:
            getattr(self, name).in_keys = self._read_by(name)

    @property
    def threshold(self) -> float:
        """The system loss below which the term is active; it can be set."""
        return self.gate.threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self.gate.threshold = value

    def reset_parameters_recursive(self) -> None:
        """As :meth:`ActorPenalty.reset_parameters_recursive`; the gate is closed until the new losses are known."""
        super().reset_parameters_recursive()
        self.gate.close()

    @property
    def active(self) -> bool:
        """Whether the last system loss was under the threshold; always true in a graph of ``torch.compile``."""
        return self.gate.is_open

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The term of :meth:`look_ahead` ``[*B]`` while the gate is open."""
        first = self._advance(acted)
        second = self._advance(first)
        term = self.gate.mask(self.look_ahead(acted, first, second), 0.0)
        return term, {"fork_term": term.detach()}

    def look_ahead(self, acted: TensorDictBase, first: TensorDictBase, second: TensorDictBase) -> Tensor:
        """The term ``[*B]`` (Eq. 2.14), of states and actions now and at the first and second predicted states."""
        g_t, g_tp1 = self._predict_reward(acted, first), self._predict_reward(first, second)
        return fork_objective(g_t, g_tp1, self.action_value(second), self.weight, self.gamma)

    def _advance(self, acted: TensorDictBase) -> TensorDictBase:
        """The state that the system network predicts, with the actor's action there."""
        with torch.set_grad_enabled(self.backprop_through_model and torch.is_grad_enabled()):
            prediction = _call(self.system_network, self.system_network_params.detach(), acted)
            state = prediction.clamp(self.observed_low, self.observed_high)
            state = self.gate.mask(state, acted.get(self.tensor_keys.observation))  # else a NaN would spread by 0 · NaN
        return self.act(TensorDict({self.tensor_keys.observation: state}, acted.batch_size, device=acted.device))

    def _predict_reward(self, acted: TensorDictBase, following: TensorDictBase) -> Tensor:
        key = self.tensor_keys.observation
        step = acted.select(key, self.tensor_keys.action).set(unravel_key(("next", key)), following.get(key))
        return _call(self.reward_network, self.reward_network_params.detach(), step).reshape(acted.batch_size)

    @property
    def model_params(self) -> list[Tensor]:
        """The parameters that the models' optimiser moves."""
        groups = [getattr(self, f"{name}_network_params") for name in self._model_names]
        return [leaf for group in groups for leaf in group.values(True, True) if isinstance(leaf, nn.Parameter)]

    @property
    def models(self) -> list[AuxiliaryModel]:
        """The networks, trained at each update; their losses move the gate."""
        gate = lambda metadata: self.update_gate(**metadata)  # noqa: E731
        return [AuxiliaryModel(parameters=self.model_params, lr=self.model_lr, loss=self.model_loss, on_update=gate)]

    def system_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The reduced error of predicted next states (:meth:`system_errors`), and its mean ``system_loss``."""
        target = self._next(tensordict, self.tensor_keys.observation)
        prediction = _call(self.system_network, self.system_network_params, tensordict)
        errors = self.system_errors(prediction, target, tensordict)
        return self._reduced(errors, tensordict), {"system_loss": errors.detach().mean()}

    def system_errors(self, prediction: Tensor, target: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Smooth-L1 of predicted next states ``[*B, D]``, clamped to the observed range: ``[*B]``."""
        return clamped_smooth_l1(prediction, target, self.observed_low, self.observed_high)

    def reward_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The reduced squared error of predicted rewards, and its mean ``reward_loss``."""
        target = self._next(tensordict, self.tensor_keys.reward).reshape(tensordict.batch_size)
        prediction = _call(self.reward_network, self.reward_network_params, tensordict)
        errors = (prediction.reshape(tensordict.batch_size) - target).square()
        return self._reduced(errors, tensordict), {"reward_loss": errors.detach().mean()}

    def model_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum of the models' losses, with ``system_loss`` and ``reward_loss`` as metadata."""
        losses, means = self._each_loss(tensordict)
        first, *rest = losses.values()
        return sum(rest, first), means

    def model_losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """``loss_system`` and ``loss_reward``; they move the gate."""
        losses, means = self._each_loss(tensordict)
        self.update_gate(**means)
        return losses

    def _each_loss(self, tensordict: TensorDictBase) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        losses: dict[str, Tensor] = {}
        means: dict[str, Tensor] = {}
        for name in self._model_names:
            losses[f"loss_{name}"], mean = getattr(self, f"{name}_loss")(tensordict)
            means |= mean
        return losses, means

    def _next(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        return tensordict.get(("next", key))

    def update_gate(self, system_loss: Tensor | float, reward_loss: Tensor | float = math.nan) -> None:
        """Opens or closes the gate by the models' mean losses; call it after each update of the models."""
        self.gate.update(system_loss, reward_loss)

    def observe(self, episodes: TensorDictBase) -> None:
        """Updates the range of the states, the returns and the weight by whole episodes ``[T]``, end to end.

        Raises:
            ValueError: when the last step ends no episode, states have another width, or a value is not finite.
        """
        keys = self.tensor_keys
        states = torch.cat([episodes.get(keys.observation), self._next(episodes, keys.observation)])
        rewards = self._next(episodes, keys.reward).reshape(-1)
        done = self._next(episodes, keys.done).reshape(-1)
        check_episodes(states, rewards, done, width=len(self.observed_low))
        super().observe(episodes)
        if self.clamp:
            low, high = (bound.to(self.observed_low) for bound in (states.amin(0), states.amax(0)))
            self.observed_low.copy_(torch.minimum(self.observed_low, low) if self.returns else low)
            self.observed_high.copy_(torch.maximum(self.observed_high, high) if self.returns else high)
        counted = episodes.get(after_step(keys.episode_reward), None)
        self.returns.extend((episode_returns(rewards, done) if counted is None else counted[done]).flatten().tolist())
        self._refresh()

    @torch.no_grad()
    def _refresh(self) -> None:
        """Computes the weight."""
        returns = torch.tensor(self.returns, dtype=self.weight.dtype)
        self.weight.copy_(fork_weight(returns, self.max_reward, self.base_weight))

    def diagnostics(self) -> dict[str, float]:
        """The weight, the share of updates since the last call that left the gate open, and the models' losses."""
        share, system_loss, reward_loss = self.gate.take()
        own = {"fork_weight": self.weight.item(), "fork_gate": share}
        return super().diagnostics() | own | {"system_loss": system_loss, "reward_loss": reward_loss}

    def get_extra_state(self) -> Tensor:
        """The gate and the returns, for ``state_dict``."""
        return torch.tensor([*self.gate.state.tolist(), *self.returns], dtype=torch.float64)

    def set_extra_state(self, state: Tensor) -> None:
        """Restores what :meth:`get_extra_state` gave."""
        gate, returns = state.tensor_split([len(self.gate.state)])
        self.gate.load(gate)
        self.returns = deque(returns.tolist(), self.returns.maxlen)


def _call(network: TensorDictModuleBase, params: TensorDictBase, inputs: TensorDictBase) -> Tensor:
    """The output of a network with these parameters; the inputs are not modified."""
    with params.to_module(network, preserve_module_state=False):
        return network(inputs.select(*network.in_keys)).get(network.out_keys[0])
