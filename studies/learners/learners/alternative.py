"""TD3 with an alternative action: at each step the critic takes the actor's action or that of a controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded

from uavrl.losses import TD3Loss


class TwoActions(nn.Module):
    """An actor that learns, a controller that does not, and the critic that chooses between them.

    Called as a network it is the actor. The controller reads the newest frame of the state, from which cells, altitude
    and heading are had back; it is one of uavrl's perception with ``angles=folded`` and without ``motion``.

    Args:
        actor: takes a state to an action.
        critic: takes a state and an action to a value; a copy of the learner's first one.
        controller: what ``demonstrator=vfh`` names, or another with its ``radius``, ``flight_level`` and
            ``last_action``.
        observations, actions, stacked: from the run.
    """

    def __init__(
        self,
        actor: nn.Module,
        critic: nn.Module,
        controller: nn.Module,
        *,
        observations: int,
        actions: int,
        stacked: int,
    ) -> None:
        super().__init__()
        self.actor, self.critic, self.controller = actor, critic.requires_grad_(False), controller
        self.width = observations // stacked
        self.cells = self.width - 3 - actions * bool(controller.last_action)

    def forward(self, observation: Tensor) -> Tensor:
        """``[*B, observations]`` to the actor's action ``[*B, actions]``."""
        return self.actor(observation)

    def alternative(self, observation: Tensor) -> Tensor:
        """``[*B, observations]`` to the controller's action ``[*B, actions]``."""
        frame = observation[..., -self.width :].reshape(-1, self.width)
        cells, altitude, heading = frame[:, : self.cells], frame[:, [self.cells]], frame[:, [self.cells + 1]]
        seen = {
            "faces": cells * self.controller.radius,
            "altitude": (altitude + 1) * self.controller.vehicle.flight_level,
            "heading_deg": (180 * heading).remainder(360),
            "observation": frame,
        }
        acted = self.controller(TensorDict(seen, [len(frame)]))["action"]
        return acted.reshape(*observation.shape[:-1], -1)


class GreaterValue(TensorDictModuleBase):
    """The policy: a(s) is the alternative's action b(s) where Q(s, b(s)) > Q(s, μ(s)), else the actor's μ(s).

    Args:
        network: both actions, and the critic.
    """

    def __init__(self, network: TwoActions) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation"], ["action"]
        self.network = network
        self.counted: Tensor  # how often the alternative was taken, of how many
        self.register_buffer("counted", torch.zeros(2))

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``."""
        state, value = tensordict["observation"], self.network.critic
        own, other = self.network(state), self.network.alternative(state)
        better = value(state, other) > value(state, own)
        self.counted += torch.tensor([float(better.sum()), float(better.numel())], device=self.counted.device)
        return tensordict.set("action", torch.where(better, other, own))


class AlternativeTD3Loss(TD3Loss):
    """TD3 whose policy is :class:`GreaterValue`, where data are collected and where it is used; the losses are TD3's.

    Source: Zhang et al. (2020), Model-Free Attitude Control of Spacecraft Based on PID-Guide TD3 Algorithm,
    International Journal of Aerospace Engineering 2020:8874619, Algorithm 1: one action of the policy with exploration
    noise, another of a PID controller; by the thesis (Chansuparp 2022, chapter 2) both are valued by Q, which decides.

    What differs from the paper, or is not known of it:

    - The alternative is a scripted controller that avoids obstacles, in place of a PID controller of an attitude.
    - The first of the two critics decides. Its copy in the policy is renewed after each episode, before the updates
      that follow, so that it is one episode late.
    - Exploration noise is added to whichever action was taken; the paper's Algorithm 1 adds it to the policy's.
    - Targets are of the target actor alone, as in TD3. Random actions come first, as in TD3 here.
    """

    _policy: list[GreaterValue]  # in a list: it is no part of the loss

    @classmethod
    def policy_of(cls, network: nn.Module, action_spec: Bounded) -> TensorDictModuleBase:
        """The choosing policy of a :class:`TwoActions`."""
        return GreaterValue(network)

    @classmethod
    def of_networks(
        cls, actor: TensorDictModuleBase, critics: Sequence[TensorDictModule], action_spec: Bounded, **options: Any
    ) -> Self:
        """The loss of the policy's actor and two critics."""
        learning = TensorDictModule(actor.network.actor, in_keys=["observation"], out_keys=["action"])
        loss = super().of_networks(learning, critics, action_spec, **options)
        loss._policy = [actor]
        loss.renew()
        return loss

    @torch.no_grad()
    def renew(self) -> None:
        """Shows the policy the first critic as it is now."""
        learned = self.qvalue_network_params.data[0]["module"]
        TensorDict.from_module(self._policy[0].network.critic).data.update_(learned)

    def observe(self, episodes: TensorDictBase) -> None:
        """After whole new episodes ``[T]``."""
        super().observe(episodes)
        self.renew()

    def diagnostics(self) -> dict[str, float]:
        """How often the alternative was taken since the last time."""
        taken, steps = self._policy[0].counted.tolist()
        self._policy[0].counted.zero_()
        return super().diagnostics() | ({"alternative_share": taken / steps} if steps else {})
