"""FORK, the forward-looking actor (Wei & Ying (2020), arXiv 2010.01652), for any actor–critic loss."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor, nn

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.enhancer import Enhancer, Model
from uavrl.losses.functional import (
    bipedal_fork_objective,
    clamped_smooth_l1,
    fork_objective,
    fork_weight,
    masked_mse,
)
from uavrl.ranges import Count, Discount, NonNegative, Positive

Variant = Literal["fork", "bipedal"]


class Fork(Enhancer):
    """Lets the actor look two predicted steps ahead (Chansuparp (2022), Eq. 2.14).

    A system network predicts the next state, a reward network the reward. To the actor's objective comes
    ``-w [g(s, s1, μ(s)) + γ g(s1, s2, μ(s1)) + γ² Q(s2, μ(s2))]`` with ``s1 = f(s, μ(s))`` and
    ``s2 = f(s1, μ(s1))``, while the last system loss is under ``threshold``. The weight falls as returns
    rise: ``w = base_weight (1 - clip(mean of the last returns / max_reward, 0, 1))``.

    The variant ``"bipedal"`` is what the authors run on the hard-core bipedal walker: no reward network, target
    critics throughout the actor's loss (the base's part included), ``-w Q'(s1, μ(s1)) - 0.5 w Q'(s2, μ(s2))``,
    and a system loss that leaves out the last transition of each episode.

    Args:
        base: the loss to enhance, or another enhancer. Its actor reads one key, the state.
        system_network: of state and ``action`` to the next state, such as :class:`uavrl.models.SystemNet`.
        reward_network: of state, next state and ``action`` to the reward ``[*B, 1]``, such as
            :class:`uavrl.models.RewardNet`; none in the bipedal variant.
        observations: width of the state.
        max_reward: return at which the weight is 0; by default 300 for the bipedal variant.
        gamma: discount γ of the predicted steps.
        base_weight: the weight at returns of 0 and below; by default 0.6, and 1 for the bipedal variant.
        threshold: the term counts while the system loss is below this.
        return_window: how many of the last returns are averaged.
        variant: ``"fork"`` or ``"bipedal"``.
        backprop_through_model: let the actor's gradient flow through predicted states; the authors detach them.
        clamp: clamp predicted states to the range observed so far, each dimension by itself.
        model_lr: Adam's step for both networks, for whoever trains them.

    Raises:
        ValueError: for an unknown variant, a network too many or too few, no ``max_reward``, or several state keys.

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
    class _AcceptedKeys(Enhancer._AcceptedKeys):
        """The keys that FORK reads of a transition; ``observation`` and ``action`` are first the actor's.

        ``episode_reward`` is what TorchRL's ``RewardSum`` writes under ``"next"``: where it is there, it gives the
        returns of :meth:`Fork.observe`, which are then those from before another transform changed the rewards.
        """

        observation: NestedKey = "observation"
        action: NestedKey = "action"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        episode_reward: NestedKey = "episode_reward"

    default_keys = _AcceptedKeys

    system_network: TensorDictModuleBase
    system_network_params: TensorDictParams
    target_system_network_params: TensorDictParams
    reward_network: TensorDictModuleBase
    reward_network_params: TensorDictParams
    target_reward_network_params: TensorDictParams
    weight: Tensor
    _gate: Tensor
    observed_low: Tensor
    observed_high: Tensor

    def __init__(
        self,
        base: ActorCriticLoss,
        *,
        system_network: nn.Module,
        reward_network: nn.Module | None = None,
        observations: int,
        max_reward: Positive | None = None,
        gamma: Discount = 0.99,
        base_weight: NonNegative | None = None,
        threshold: Positive = 0.020,
        return_window: Count = 100,
        variant: Variant = "fork",
        backprop_through_model: bool = False,
        clamp: bool = True,
        model_lr: Positive = 3e-4,
    ) -> None:
        _check(variant, reward_network, max_reward)
        super().__init__(base)
        self.tensor_keys.observation, self.tensor_keys.action = _state_key(base), _action_key(base)
        self._wrapped: list[str] = []  # networks that came without keys
        self._add_network("system_network", system_network, ("next", self.tensor_keys.observation))
        if reward_network is not None:
            self._add_network("reward_network", reward_network, ("next", self.tensor_keys.reward))
        self.variant = variant
        self.gamma = gamma
        self.threshold = threshold
        self.backprop_through_model = backprop_through_model
        self.clamp = clamp
        self.model_lr = model_lr
        self.max_reward = 300.0 if max_reward is None else max_reward
        self.base_weight = {"fork": 0.6, "bipedal": 1.0}[variant] if base_weight is None else base_weight
        device = self.system_network_params.device or next(self.parameters()).device
        self.register_buffer("weight", torch.tensor(float(self.base_weight), device=device))
        self.register_buffer("observed_low", torch.full((observations,), -math.inf, device=device))
        self.register_buffer("observed_high", torch.full((observations,), math.inf, device=device))
        self.returns: deque[float] = deque(maxlen=return_window)
        self.out_keys = [*self.out_keys, "loss_system", *(["loss_reward"] if variant == "fork" else [])]
        # Whether the gate is open, the last losses of both networks, and how many of how many updates left it open: on
        # the device, since torch.compile breaks a graph that takes a number off it. The extra state saves it.
        gate = torch.tensor([0.0, math.nan, math.nan, 0.0, 0.0], dtype=torch.float64, device=device)
        self.register_buffer("_gate", gate, persistent=False)
        self._open: bool | None = False  # the first of them, None until somebody asks

    def _add_network(self, name: str, network: nn.Module, out_key: NestedKey) -> None:
        if not isinstance(network, TensorDictModuleBase):
            network = TensorDictModule(network, self._read_by(name), [unravel_key(out_key)])
            self._wrapped.append(name)
        self.convert_to_functional(network, name)

    def _read_by(self, name: str) -> list[NestedKey]:
        state, action = self.tensor_keys.observation, self.tensor_keys.action
        return [state, action] if name == "system_network" else [state, unravel_key(("next", state)), action]

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """As :meth:`Enhancer.set_keys`; networks that are given without keys of their own read the new ones."""
        super().set_keys(**kwargs)
        for name in self._wrapped:
            getattr(self, name).in_keys = self._read_by(name)

    def reset_parameters_recursive(self) -> None:
        """As :meth:`Enhancer.reset_parameters_recursive`; the gate is closed until the new models' losses are known."""
        super().reset_parameters_recursive()
        self._gate[0], self._gate[1:3], self._open = 0.0, math.nan, False

    @property
    def active(self) -> bool:
        """Whether the gate is open, because the last system loss was under the threshold.

        A branch on that would break a graph of ``torch.compile``: it always has the term, 0 while the gate is closed.
        """
        if torch.compiler.is_compiling():
            return True
        if self._open is None:
            self._open = bool(self._gate[0])
        return self._open

    def _while_open(self, value: Tensor, otherwise: Tensor | float) -> Tensor:
        """The value; in a compiled graph only while the gate is open."""
        return torch.where(self._gate[0] > 0, value, otherwise) if torch.compiler.is_compiling() else value

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's objective, and the term while the gate is open; the bipedal variant asks the target critics."""
        return super().actor_objective(acted, target=target or self.variant == "bipedal")

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The term of each sample ``[*B]`` (Eq. 2.14).

        Args:
            acted: ``[*B]`` with the state and the actor's action.
        """
        first = self._advance(acted)
        second = self._advance(first)
        if self.variant == "bipedal":
            q_tp1, q_tp2 = self.action_value(first, target=True), self.action_value(second, target=True)
            term = bipedal_fork_objective(q_tp1, q_tp2, self.weight)
        else:
            g_t, g_tp1 = self._predict_reward(acted, first), self._predict_reward(first, second)
            term = fork_objective(g_t, g_tp1, self.action_value(second), self.weight, self.gamma)
        term = self._while_open(term, 0.0)
        return term, {"fork_term": term.detach()}

    def _advance(self, acted: TensorDictBase) -> TensorDictBase:
        """The state that the system network predicts, with the actor's action there."""
        with torch.set_grad_enabled(self.backprop_through_model and torch.is_grad_enabled()):
            prediction = _call(self.system_network, self.system_network_params.detach(), acted)
            state = prediction.clamp(self.observed_low, self.observed_high)
            state = self._while_open(state, acted.get(self.tensor_keys.observation))  # else 0 times NaN would count
        return self.act(TensorDict({self.tensor_keys.observation: state}, acted.batch_size, device=acted.device))

    def _predict_reward(self, acted: TensorDictBase, following: TensorDictBase) -> Tensor:
        key = self.tensor_keys.observation
        step = acted.select(key, self.tensor_keys.action).set(unravel_key(("next", key)), following.get(key))
        return _call(self.reward_network, self.reward_network_params.detach(), step).reshape(acted.batch_size)

    @property
    def model_params(self) -> list[Tensor]:
        """The parameters that the models' optimiser moves."""
        groups = [self.system_network_params] + ([self.reward_network_params] if self.variant == "fork" else [])
        return [leaf for group in groups for leaf in group.values(True, True) if isinstance(leaf, nn.Parameter)]

    @property
    def models(self) -> list[Model]:
        """Both networks, trained at each update; their loss moves the gate."""
        learned = lambda metadata: self.update_gate(**metadata)  # noqa: E731
        return [Model(parameters=self.model_params, lr=self.model_lr, loss=self.model_loss, learned=learned)]

    def system_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Smooth-L1 of the predicted next state, clamped to the observed range (bipedal: masked squared error).

        Args:
            tensordict: ``[*B]`` with state, action and the next state (bipedal: and ``("next", "done")``).

        Returns:
            The reduced loss and the mean ``system_loss``, detached.
        """
        target = self._next(tensordict, self.tensor_keys.observation)
        prediction = _call(self.system_network, self.system_network_params, tensordict)
        if self.variant == "bipedal":
            done = self._next(tensordict, self.tensor_keys.done).reshape(tensordict.batch_size)
            errors = masked_mse(prediction, target, done)
        else:
            errors = clamped_smooth_l1(prediction, target, self.observed_low, self.observed_high)
        return self._reduced(errors, tensordict), {"system_loss": errors.detach().mean()}

    def reward_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Squared error of the predicted reward.

        Args:
            tensordict: ``[*B]`` with state, action, the next state and ``("next", "reward")``.

        Returns:
            The reduced loss and the mean ``reward_loss``, detached.

        Raises:
            ValueError: for the bipedal variant, which predicts no rewards.
        """
        if self.variant == "bipedal":
            raise ValueError("reward_loss expected a reward network, the bipedal variant has none: use system_loss.")
        target = self._next(tensordict, self.tensor_keys.reward).reshape(tensordict.batch_size)
        prediction = _call(self.reward_network, self.reward_network_params, tensordict)
        errors = (prediction.reshape(tensordict.batch_size) - target).square()
        return self._reduced(errors, tensordict), {"reward_loss": errors.detach().mean()}

    def model_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum of the models' losses, with ``system_loss`` and ``reward_loss`` as metadata."""
        loss, metadata = self.system_loss(tensordict)
        if self.variant == "bipedal":
            return loss, metadata
        reward_loss, more = self.reward_loss(tensordict)
        return loss + reward_loss, metadata | more

    def model_losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """``loss_system`` and ``loss_reward``; the gate learns of them."""
        loss, means = self.system_loss(tensordict)
        losses = {"loss_system": loss}
        if self.variant == "fork":
            losses["loss_reward"], more = self.reward_loss(tensordict)
            means |= more
        self.update_gate(**means)
        return losses

    def _next(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        return tensordict.get(unravel_key(("next", key)))

    def _reduced(self, errors: Tensor, tensordict: TensorDictBase) -> Tensor:
        weights = self._maybe_get_priority_weight(tensordict)
        return self._reduce_loss(errors, tensordict=tensordict, weights=weights)

    @torch.no_grad()
    def update_gate(self, system_loss: Tensor | float, reward_loss: Tensor | float = math.nan) -> None:
        """Opens the gate if the system loss is under the threshold, else closes it.

        :meth:`forward` calls it; a training loop of single losses calls it after each update of the models.

        Args:
            system_loss: mean loss of the system network on a batch.
            reward_loss: that of the reward network, for :meth:`diagnostics`.
        """
        gate = self._gate
        gate[1], gate[2] = system_loss, reward_loss
        gate[0] = gate[1] < self.threshold
        gate[3] += gate[0]
        gate[4] += 1
        self._open = None if torch.compiler.is_compiling() else bool(gate[0])

    def observe(self, episodes: TensorDictBase) -> None:
        """Takes in new episodes: the range of the states, the returns, and so the weight.

        Args:
            episodes: ``[T]``, whole episodes end to end, split where ``("next", "done")`` is true.

        Raises:
            ValueError: when the last step ends no episode, states have another width, or a value is not finite.
        """
        keys = self.tensor_keys
        states = torch.cat([episodes.get(keys.observation), self._next(episodes, keys.observation)])
        rewards = self._next(episodes, keys.reward).reshape(-1)
        done = self._next(episodes, keys.done).reshape(-1)
        self._check_episodes(episodes, states, rewards, done)
        super().observe(episodes)
        if self.clamp:
            low, high = (bound.to(self.observed_low) for bound in (states.amin(0), states.amax(0)))
            first = len(self.returns) == 0
            self.observed_low.copy_(low if first else torch.minimum(self.observed_low, low))
            self.observed_high.copy_(high if first else torch.maximum(self.observed_high, high))
        self.returns.extend(self._episode_returns(episodes, rewards, done).tolist())
        returns = torch.tensor(self.returns, dtype=self.weight.dtype)
        self.weight.copy_(fork_weight(returns, self.max_reward, self.base_weight))

    def _episode_returns(self, episodes: TensorDictBase, rewards: Tensor, done: Tensor) -> Tensor:
        """``[E]``: what ``RewardSum`` counted, or the sums of the rewards."""
        counted = episodes.get(unravel_key(("next", self.tensor_keys.episode_reward)), None)
        if counted is not None:
            return counted.reshape(-1)[done]
        episode = done.cumsum(0) - done.long()
        return rewards.new_zeros(int(done.sum())).index_add(0, episode, rewards)

    def _check_episodes(self, episodes: TensorDictBase, states: Tensor, rewards: Tensor, done: Tensor) -> None:
        width = self.observed_low.shape[0]
        if episodes.ndim != 1 or not len(done) or not done[-1]:
            raise ValueError(
                f"observe expected whole episodes [T], the last step done, got a batch {list(episodes.batch_size)} "
                f"that is not: flatten it, and leave out the episode that has not ended."
            )
        if states.shape[-1] != width:
            raise ValueError(f"observe expected states of width {width}, got {states.shape[-1]}: set observations.")
        for name, values in (("states", states), ("rewards", rewards)):
            if bad := int((~values.isfinite()).sum()):
                raise ValueError(f"observe expected finite {name}, got {bad} values that are not: mend the world.")

    def diagnostics(self) -> dict[str, float]:
        """The weight, the share of updates since the last call that left the gate open, and the models' losses."""
        gate, system_loss, reward_loss, openings, updates = self._gate.tolist()
        self._gate[3:] = 0.0
        return super().diagnostics() | {
            "fork_weight": self.weight.item(),
            "fork_gate": openings / updates if updates else gate,
            "system_loss": system_loss,
            "reward_loss": reward_loss,
        }

    def get_extra_state(self) -> Tensor:
        """What the state dict holds beside tensors: the gate, what diagnostics count, and the returns."""
        return torch.tensor([*self._gate.tolist(), *self.returns], dtype=torch.float64)

    def set_extra_state(self, state: Tensor) -> None:
        """Restores what :meth:`get_extra_state` gave."""
        count = len(self._gate)
        self._gate.copy_(state[:count])
        self._open = None
        self.returns.clear()
        self.returns.extend(state[count:].tolist())


def _call(network: TensorDictModuleBase, params: TensorDictBase, inputs: TensorDictBase) -> Tensor:
    """What a network with these parameters writes; the inputs are not modified."""
    with params.to_module(network, preserve_module_state=False):
        return network(inputs.select(*network.in_keys)).get(network.out_keys[0])


def _state_key(base: ActorCriticLoss) -> NestedKey:
    keys = base.unenhanced.actor_network.in_keys
    if len(keys) != 1:
        raise ValueError(f"Fork expected an actor that reads one key, the state, got {keys}: concatenate them first.")
    return keys[0]


def _action_key(base: ActorCriticLoss) -> NestedKey:
    own = base.unenhanced
    return getattr(own.tensor_keys, "action", own.actor_network.out_keys[-1])


def _check(variant: str, reward_network: nn.Module | None, max_reward: float | None) -> None:
    if variant not in ("fork", "bipedal"):
        raise ValueError(f"Fork expected the variant 'fork' or 'bipedal', got {variant!r}: choose one.")
    if (reward_network is None) == (variant == "fork"):
        wanted, got = ("a", "none") if variant == "fork" else ("no", "one")
        raise ValueError(f"The variant {variant!r} expected {wanted} reward_network, got {got}: change one of the two.")
    if max_reward is None and variant == "fork":
        raise ValueError("Fork expected max_reward, got none: give the return at which its weight shall be 0.")
