"""Small losses of every kind, and whole episodes for LifeGuard to learn from."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded

from uavrl.losses import ActorCriticLoss, DDPGLoss, Fork, LifeGuard, SACLoss, TD3Loss
from uavrl.models import Actor, Critic, GaussianActor, RewardNet, SystemNet

OBSERVATIONS, ACTIONS = 3, 2  # the last observation is the second half of a state of 6
SPEC = Bounded(-2.0, 2.0, (ACTIONS,))


def actor() -> TensorDictModule:
    return TensorDictModule(Actor(6, 2, (8,)), ["observation"], ["action"])


def stochastic_actor() -> TensorDictModuleBase:
    return SACLoss.policy_of(GaussianActor(6, 2, (8,)), SPEC)


def critics() -> list[TensorDictModule]:
    return [TensorDictModule(Critic(6, 2, (8,)), ["observation", "action"], ["state_action_value"]) for _ in range(2)]


def td3(**kwargs: object) -> TD3Loss:
    return TD3Loss(actor(), critics(), action_spec=SPEC, **kwargs)


def ddpg(**kwargs: object) -> DDPGLoss:
    return DDPGLoss(actor(), critics()[0], **kwargs)


def sac(**kwargs: object) -> SACLoss:
    return SACLoss(stochastic_actor(), critics(), action_spec=SPEC, **kwargs)


def fork(base: ActorCriticLoss, **kwargs: object) -> Fork:
    models = {"system_network": SystemNet(6, 2, (8,)), "reward_network": RewardNet(6, 2, (8,)), "max_reward": 100.0}
    return Fork(base, observations=6, **(models | kwargs))


class Scale(nn.Module):
    """A number times the sum of its inputs' first columns."""

    def __init__(self, *factors: float) -> None:
        super().__init__()
        self.factors = nn.Parameter(torch.tensor(factors))

    def forward(self, *inputs: Tensor) -> Tensor:
        return sum(factor * value for factor, value in zip(self.factors, inputs, strict=True))


def small_td3() -> TD3Loss:
    """μ(s) = 2 s, Q1(s, a) = s + 3 a; the targets have Q1 = 5 a."""
    policy = TensorDictModule(Scale(2.0), ["observation"], ["action"])
    values = [
        TensorDictModule(Scale(*factors), ["observation", "action"], ["state_action_value"])
        for factors in ((1.0, 3.0), (7.0, 7.0))
    ]
    base = TD3Loss(policy, values, action_spec=Bounded(-9.0, 9.0, (1,)))
    base.target_qvalue_network_params["module", "factors"].data[0] = torch.tensor([0.0, 5.0])
    return base


def states(*values: float) -> TensorDict:
    return TensorDict({"observation": torch.tensor(values)[:, None]}, [len(values)])


def lifeguard(base: ActorCriticLoss | None = None, **kwargs: object) -> LifeGuard:
    settings = {"min_collisions": 4, "min_evaluations": 2, "batch_size": 20, "evaluation_window": 4}
    return LifeGuard(base or td3(), observations=OBSERVATIONS, actions=ACTIONS, **settings | kwargs)


def episodes(count: int, steps: int = 5, *, collided: bool = True, arrived: bool = False) -> TensorDict:
    """Whole episodes, end to end, whose last steps have a large last observation where they collide."""
    size = count * steps
    last = torch.arange(size) % steps == steps - 1
    state, action = torch.rand(size, 6), 4 * torch.rand(size, 2) - 2
    if collided:
        state[:, 3:] += 2.0 * last[:, None]
    flags = {"done": last, "collided": last & collided, "arrived": last & arrived}
    return TensorDict(
        {"observation": state, "action": action, "next": {name: flag[:, None] for name, flag in flags.items()}}, [size]
    )


def sampler(data: TensorDict) -> Callable[[int], TensorDict]:
    return lambda n: data[torch.randint(len(data), (n,))]


def trained(loss: LifeGuard, rounds: int = 8) -> LifeGuard:
    """Trained on collisions that are easy to classify, until its penalty is active."""
    data = episodes(10)
    optimizer = loss.make_optimizer()
    for _ in range(rounds):
        loss.observe(data)
        loss.fit(sampler(data), 20, optimizer)
    assert loss.active
    return loss
