"""Complete updates of TD3, DDPG, TD3-FORK and TD3-LG in plain PyTorch, written from the papers' equations.

Nothing here comes from the library, from TorchRL or from tensordict: the tests hold the library against it.
"""

from __future__ import annotations

import copy
import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

GAMMA = 0.99
TAU = 0.005
POLICY_DELAY = 2
ACTOR_LR = 1e-4
CRITIC_LR = 1e-3
POLICY_NOISE = 0.2
NOISE_CLIP = 0.5


@dataclass
class Batch:
    """Transitions. `terminated` is true at a success or a collision only, a time-out bootstraps."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor


def relu_network(sizes: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Actor(nn.Module):
    """A deterministic policy whose actions fill [low, high]."""

    def __init__(self, observation_size: int, cells: Sequence[int], low: Tensor, high: Tensor) -> None:
        super().__init__()
        self.body = relu_network([observation_size, *cells, low.numel()])
        self.middle, self.half = (high + low) / 2, (high - low) / 2

    def forward(self, observation: Tensor) -> Tensor:
        return self.middle + self.half * torch.tanh(self.body(observation))


class OfPair(nn.Module):
    """A network of several inputs laid side by side: Q(s, a), the system net f(s, a), the reward net g(s, s', a)."""

    def __init__(self, input_size: int, cells: Sequence[int], output_size: int) -> None:
        super().__init__()
        self.body = relu_network([input_size, *cells, output_size])

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.body(torch.cat(inputs, -1))


def adam(module: nn.Module, lr: float) -> torch.optim.Adam:
    return torch.optim.Adam(module.parameters(), lr=lr, fused=False, foreach=False)


def step(optimizer: torch.optim.Optimizer, loss: Tensor) -> list[Tensor]:
    """One optimiser step on `loss`; returns the gradients it used."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    gradients = [parameter.grad.clone() for parameter in parameters]
    optimizer.step()
    return gradients


class ActorLoss:
    """What the actor minimises: -Q1(s, mu(s)). FORK and the LifeGuard add terms to it."""

    def after_critics(self, oracle: DDPG, batch: Batch) -> None:
        """What this term learns from the batch, before the actor moves."""

    def term(self, oracle: DDPG, observation: Tensor, action: Tensor) -> Tensor | None:
        """The loss this term adds for each transition; None adds nothing."""
        raise NotImplementedError


class DDPG:
    """Eq. 2.7 - 2.9: one critic; the actor and both targets move at every update."""

    delay = 1

    def __init__(
        self,
        actor: Actor,
        critics: Sequence[OfPair],
        low: Tensor,
        high: Tensor,
        penalties: Sequence[ActorLoss] = (),
    ) -> None:
        self.actor, self.critics = actor, list(critics)
        self.target_actor, self.target_critics = copy.deepcopy(actor), copy.deepcopy(self.critics)
        self.actor_optimizer = adam(actor, ACTOR_LR)
        self.critic_optimizers = [adam(critic, CRITIC_LR) for critic in self.critics]
        self.low, self.high = low, high
        self.penalties = list(penalties)
        self.updates = 0
        self.losses: dict[str, float] = {}
        self.gradients: dict[str, list[Tensor]] = {}

    def next_action(self, batch: Batch) -> Tensor:
        return self.target_actor(batch.next_observation)

    def target(self, batch: Batch) -> Tensor:
        with torch.no_grad():
            action = self.next_action(batch)
            values = torch.cat([critic(batch.next_observation, action) for critic in self.target_critics], -1)
            value = values.min(-1, keepdim=True).values
            return batch.reward + GAMMA * (~batch.terminated).to(value.dtype) * value

    def update(self, batch: Batch) -> None:
        """One update on one batch: the critics, what the penalties learn, and every `delay` times actor and targets."""
        self.updates += 1
        self.losses, self.gradients = {}, {}
        target = self.target(batch)
        total = 0.0
        for index, (critic, optimizer) in enumerate(zip(self.critics, self.critic_optimizers, strict=True)):
            loss = ((critic(batch.observation, batch.action) - target) ** 2).mean()
            total += loss.item()
            self.gradients[f"critic{index}"] = step(optimizer, loss)
        self.losses["critic"] = total
        for penalty in self.penalties:
            penalty.after_critics(self, batch)
        if self.updates % self.delay == 0:
            self.update_actor(batch)
            self.update_targets()

    def update_actor(self, batch: Batch) -> None:
        action = self.actor(batch.observation)
        loss = -self.critics[0](batch.observation, action)
        for penalty in self.penalties:
            term = penalty.term(self, batch.observation, action)
            if term is not None:
                loss = loss + term
        mean = loss.mean()
        self.losses["actor"] = mean.item()
        self.gradients["actor"] = step(self.actor_optimizer, mean)

    def update_targets(self) -> None:
        pairs = [(self.target_actor, self.actor), *zip(self.target_critics, self.critics, strict=True)]
        with torch.no_grad():
            for slow, fast in pairs:
                for old, new in zip(slow.parameters(), fast.parameters(), strict=True):
                    old.copy_(TAU * new + (1 - TAU) * old)


class TD3(DDPG):
    """Eq. 2.10 - 2.12: smoothed target actions, the smaller of two critics, a delayed actor and delayed targets."""

    delay = POLICY_DELAY

    def next_action(self, batch: Batch) -> Tensor:
        half = (self.high - self.low) / 2
        noise = torch.randn_like(batch.action) * POLICY_NOISE * half
        noise = torch.minimum(torch.maximum(noise, -NOISE_CLIP * half), NOISE_CLIP * half)
        action = self.target_actor(batch.next_observation) + noise
        return torch.minimum(torch.maximum(action, self.low), self.high)


class Fork(ActorLoss):
    """Eq. 2.14 as its authors coded it: predictions detached, a gate on the system net's loss, a weight by return."""

    def __init__(self, system: OfPair, reward: OfPair, *, lr: float, threshold: float, max_reward: float) -> None:
        self.system, self.reward = system, reward
        self.system_optimizer, self.reward_optimizer = adam(system, lr), adam(reward, lr)
        self.threshold, self.max_reward = threshold, max_reward
        self.returns: deque[float] = deque(maxlen=100)
        self.lowest: Tensor | None = None
        self.highest: Tensor | None = None
        self.open = False
        self.opened: list[bool] = []

    def observe(self, observations: Tensor) -> None:
        """The range of the observations seen so far, per dimension."""
        low, high = observations.amin(0), observations.amax(0)
        self.lowest = low if self.lowest is None else torch.minimum(self.lowest, low)
        self.highest = high if self.highest is None else torch.maximum(self.highest, high)

    def weight(self) -> float:
        mean = sum(self.returns) / len(self.returns) if self.returns else 0.0
        return 0.6 * (1 - min(max(mean / self.max_reward, 0.0), 1.0))

    def predict(self, observation: Tensor, action: Tensor) -> Tensor:
        assert self.lowest is not None and self.highest is not None
        return torch.minimum(torch.maximum(self.system(observation, action), self.lowest), self.highest)

    def after_critics(self, oracle: DDPG, batch: Batch) -> None:
        predicted = self.predict(batch.observation, batch.action)
        loss = functional.smooth_l1_loss(predicted, batch.next_observation)
        oracle.losses["system"] = loss.item()
        oracle.gradients["system"] = step(self.system_optimizer, loss)
        self.open = loss.item() < self.threshold
        self.opened.append(self.open)
        predicted_reward = self.reward(batch.observation, batch.next_observation, batch.action)
        loss = ((predicted_reward - batch.reward) ** 2).mean()
        oracle.losses["reward"] = loss.item()
        oracle.gradients["reward"] = step(self.reward_optimizer, loss)

    def term(self, oracle: DDPG, observation: Tensor, action: Tensor) -> Tensor | None:
        if not self.open:
            return None
        first = self.predict(observation, action).detach()
        first_action = oracle.actor(first)
        second = self.predict(first, first_action).detach()
        second_action = oracle.actor(second)
        ahead = (
            self.reward(observation, first, action)
            + GAMMA * self.reward(first, second, first_action)
            + GAMMA**2 * oracle.critics[0](second, second_action)
        )
        return -self.weight() * ahead


class LifeGuard(ActorLoss):
    """Eq. 3.11: the predicted probability of a collision is taken off the value, -(Q1 - weight sigmoid(c)).

    `logit` is the classifier; this module does not say how it is trained, and when the penalty is active.
    """

    def __init__(self, logit: Callable[[Tensor], Tensor], *, last: int, penalty: float = 10.0) -> None:
        self.logit = logit
        self.last = last  # width of the last observation, at the end of the stacked state
        self.penalty = penalty
        self.active = False
        self.successes: deque[bool] = deque(maxlen=100)
        self.lowest: Tensor | None = None
        self.highest: Tensor | None = None

    def features(self, observation: Tensor, action: Tensor) -> Tensor:
        return torch.cat([observation[..., -self.last :], action], -1)

    def observe(self, observations: Tensor, actions: Tensor, successes: Sequence[bool]) -> None:
        """The range of the features seen so far, and how the episodes ended."""
        features = self.features(observations, actions)
        low, high = features.amin(0), features.amax(0)
        self.lowest = low if self.lowest is None else torch.minimum(self.lowest, low)
        self.highest = high if self.highest is None else torch.maximum(self.highest, high)
        self.successes.extend(successes)

    def weight(self) -> float:
        success = sum(self.successes) / len(self.successes) if self.successes else 0.0
        return self.penalty * (1 - min(max(success, 0.0), 1.0))

    def term(self, oracle: DDPG, observation: Tensor, action: Tensor) -> Tensor | None:
        if not self.active:
            return None
        assert self.lowest is not None and self.highest is not None
        scaled = (self.features(observation, action) - self.lowest) / (self.highest - self.lowest)
        return self.weight() * torch.sigmoid(self.logit(scaled))
