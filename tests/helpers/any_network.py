"""The stepper against TD3 and SAC written out in plain PyTorch, with networks that the library has never seen."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.nn.functional import softplus
from torchrl.data import Bounded
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal

from tests.helpers import oracle
from tests.helpers.updates import ACTIONS, STATE, batch_number, cast, plain
from uavrl.losses import ActorCriticLoss, SACLoss, TD3Loss
from uavrl.models import Critic
from uavrl.training.compiled import Execution
from uavrl.training.update import ActorCriticStepper

UPDATES = 30


class Doubled(Critic):
    """A subclass with a forward of its own."""

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return 2 * super().forward(observation, action)


class Normed(nn.Module):
    """Inputs scaled by a buffer, LayerNorm, a frozen layer, and a parameter that nothing reads."""

    scale: Tensor

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.register_buffer("scale", torch.linspace(0.5, 2.0, inputs))
        self.register_buffer("seen", torch.tensor(3))
        self.body = nn.Sequential(
            nn.Linear(inputs, 16), nn.LayerNorm(16), nn.ReLU(), nn.Linear(16, 9), nn.Linear(9, outputs)
        )
        self.body[3].requires_grad_(False)
        self.unread = nn.Parameter(torch.ones(3))

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.body(torch.cat(inputs, -1) * self.scale)


def edited() -> Critic:
    """The library's critic, with a layer put in."""
    critic = Critic(STATE, ACTIONS, (16, 9))
    critic.net.insert(1, nn.LayerNorm(16))
    nn.init.uniform_(critic.net[1].weight)
    return critic


CRITICS: dict[str, Callable[[], nn.Module]] = {
    "ours": lambda: Critic(STATE, ACTIONS, (16, 9)),
    "a subclass": lambda: Doubled(STATE, ACTIONS, (16, 9)),
    "TorchRL's": lambda: MLP(in_features=STATE + ACTIONS, out_features=1, num_cells=[16, 9]),
    "LayerNorm and a buffer": lambda: Normed(STATE + ACTIONS, 1),
    "ours with LayerNorm": edited,
}


class Policy(nn.Module):
    """2 tanh of a network."""

    def __init__(self) -> None:
        super().__init__()
        self.net = Normed(STATE, ACTIONS)

    def forward(self, state: Tensor) -> Tensor:
        return 2 * self.net(state).tanh()


class Gaussian(nn.Module):
    """Mean and deviation."""

    def __init__(self) -> None:
        super().__init__()
        self.net = Normed(STATE, 2 * ACTIONS)

    def forward(self, state: Tensor) -> tuple[Tensor, Tensor]:
        loc, scale = self.net(state).chunk(2, -1)
        return loc, softplus(scale) + 0.1


class SAC(oracle.TD3):
    """Haarnoja et al. 2018 (arXiv 1812.05905): Eq. 5, 6, 9 and 18, with actions 2 tanh(x) and 2 critics."""

    def __init__(self, actor: nn.Module, critics: list[nn.Module]) -> None:
        super().__init__(actor, critics, torch.tensor(-2.0), torch.tensor(2.0))  # type: ignore[arg-type]
        self.log_alpha = torch.zeros((), requires_grad=True)
        self.temperature_optimizer = torch.optim.Adam([self.log_alpha], lr=3e-4)

    def sample(self, state: Tensor) -> tuple[Tensor, Tensor]:
        loc, scale = self.actor(state)
        noise = torch.randn_like(loc)
        x = loc + scale * noise
        normal = -0.5 * noise.square() - scale.log() - 0.5 * math.log(2 * math.pi)
        slope = math.log(2) + 2 * (math.log(2) - x - softplus(-2 * x))  # of 2 tanh(x)
        return 2 * x.tanh(), (normal - slope).sum(-1, keepdim=True)

    def target(self, batch: oracle.Batch) -> Tensor:
        with torch.no_grad():
            action, log_prob = self.sample(batch.next_observation)
            one, other = (critic(batch.next_observation, action) for critic in self.target_critics)
            value = torch.minimum(one, other) - self.log_alpha.exp() * log_prob
            return batch.reward + oracle.GAMMA * (~batch.terminated).to(value.dtype) * value

    def update_actor(self, batch: oracle.Batch) -> None:
        action, log_prob = self.sample(batch.observation)
        one, other = (critic(batch.observation, action) for critic in self.critics)
        loss = (self.log_alpha.exp().detach() * log_prob - torch.minimum(one, other)).mean()
        self.losses["actor"] = loss.item()
        self.gradients["actor"] = gradient_step(self.actor_optimizer, loss)
        gradient_step(self.temperature_optimizer, -(self.log_alpha * (log_prob.detach() - ACTIONS)).mean())


def gradient_step(optimizer: torch.optim.Optimizer, loss: Tensor) -> list[Tensor]:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
    return []


def by_hand(algo: str, actor: nn.Module, critics: list[nn.Module], monkeypatch: pytest.MonkeyPatch) -> oracle.TD3:
    monkeypatch.setattr(oracle, "step", gradient_step)  # the oracle's own wants a gradient of every parameter
    actor, critics = copy.deepcopy(actor), copy.deepcopy(critics)
    if algo == "sac":
        return SAC(actor, critics)
    return oracle.TD3(actor, critics, torch.tensor(-2.0), torch.tensor(2.0))  # type: ignore[arg-type]


def library(algo: str, actor: nn.Module, critics: list[nn.Module]) -> ActorCriticLoss:
    spec = Bounded(-2.0, 2.0, (ACTIONS,), dtype=torch.get_default_dtype())
    wrapped = [TensorDictModule(critic, ["observation", "action"], ["state_action_value"]) for critic in critics]
    if algo == "td3":
        return TD3Loss(TensorDictModule(actor, ["observation"], ["action"]), wrapped, action_spec=spec)
    policy = ProbabilisticActor(
        TensorDictModule(actor, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=spec,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -2.0, "high": 2.0},
        return_log_prob=True,
    )
    return SACLoss(policy, wrapped, action_spec=spec)


def compare(params: TensorDictBase, networks: list[nn.Module], tolerance: float) -> None:
    """Each weight and buffer of the library's stacked networks with those of the others."""
    found = {key.split("module.")[-1]: value for key, value in params.flatten_keys(".").items()}
    expected = [network.state_dict() for network in networks]
    assert found.keys() == expected[0].keys()
    for key, value in found.items():
        other = torch.stack([one[key] for one in expected]) if len(expected) > 1 else expected[0][key]
        torch.testing.assert_close(value.data, other, rtol=tolerance, atol=tolerance, msg=f"{{}} ({key})".format)


def compare_updates(
    algo: str, make: str, execution: Execution, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Makes the same updates by the library and by hand, in a precision, and asserts that all networks agree."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        _compare_updates(algo, make, execution, dtype, monkeypatch)
    finally:
        torch.set_default_dtype(before)


def _compare_updates(
    algo: str, make: str, execution: Execution, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-9
    actor, critics = Policy() if algo == "td3" else Gaussian(), [CRITICS[make](), CRITICS[make]()]
    learner = by_hand(algo, actor, critics, monkeypatch)
    loss = library(algo, actor, critics).to(dtype)
    stepper = ActorCriticStepper(loss, policy_delay=2, execution=execution)
    start = copy.deepcopy(learner.critics)
    for update in range(UPDATES):
        data = cast(batch_number(update))
        batch = plain(data)
        torch.manual_seed(update)
        said = stepper.step(None, data)
        torch.manual_seed(update)
        learner.update(batch)
        torch.testing.assert_close(float(said["loss_value"]), learner.losses["critic"], rtol=tolerance, atol=tolerance)
    compare(loss.actor_network_params, [learner.actor], tolerance)
    compare(loss.critic_network_params, learner.critics, tolerance)
    compare(loss.target_qvalue_network_params, learner.target_critics, tolerance)
    if isinstance(learner, SAC):
        torch.testing.assert_close(loss.log_alpha.data, learner.log_alpha.data, rtol=tolerance, atol=tolerance)
    moved = [(a - b).abs().amax() for a, b in zip(start[0].parameters(), learner.critics[0].parameters(), strict=True)]
    assert max(moved) > 0.01
