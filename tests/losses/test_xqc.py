"""Critics that give distributions of the value, whose weights have norm 1."""

from __future__ import annotations

import copy
import itertools
import logging
import math
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.objectives import SoftUpdate

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import SPEC, actor, critics, stochastic_actor, td3
from tests.helpers.normalised_losses import KEYS, batch, categorical, statistics, xqc, xqc_td3
from tests.helpers.runs import small_config
from tests.helpers.torchrl_losses import PENALTIES
from uavrl.config import validate
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss, TD3Loss, XQCLoss, XQCTD3Loss
from uavrl.losses.functional import least_valued, project_distribution
from uavrl.models import BatchRenorm, CategoricalCritic, UnitNormLinear
from uavrl.training.build import build_trainer
from uavrl.training.run import create_run
from uavrl.training.update import ActorCriticStepper

BOTH = pytest.mark.parametrize("make", [xqc, xqc_td3])


class _Contract(ActorCriticLossContract):
    compiled: ClassVar[tuple[str, ...]] = ()

    def test_a_soft_update_moves_the_targets(self) -> None:
        """The parameters of all of them; statistics are moved by the loss."""
        loss = self.make_loss()
        updater = SoftUpdate(loss, tau=0.25)
        with torch.no_grad():
            for value in loss.parameters():
                value.add_(torch.rand_like(value))
        before = {key: value.clone() for key, value in loss.state_dict().items() if not key.endswith("extra_state")}
        updater.step()
        after, learned = loss.state_dict(), {key for key, _ in loss.named_parameters()}
        targets = [key for key in before if key.startswith("target_") and key.replace("target_", "") in learned]
        assert len(targets) >= 10
        for key in targets:
            expected = 0.75 * before[key] + 0.25 * before[key.replace("target_", "")]
            torch.testing.assert_close(after[key], expected)
            assert not torch.equal(before[key], after[key])

    def test_parameters_are_drawn_anew_by_each_network(self) -> None:
        """Rows of norm 1, a bias of 0; normalisations begin again, and targets are copies."""
        loss = self.seeded_loss()
        loss.value_loss(self.make_data())
        before = {key: value.clone() for key, value in loss.state_dict().items() if "net." in key}
        loss.reset_parameters_recursive()
        after = loss.state_dict()
        for key in ("net.1.weight", "net.4.weight", "net.7.weight"):
            (name,) = [each for each in before if each.startswith("qvalue") and each.endswith(key)]
            assert not torch.equal(before[name], after[name]) and not torch.equal(*after[name])
            torch.testing.assert_close(after[name].norm(dim=-1), torch.ones(after[name].shape[:-1]))
            assert torch.equal(after[name], after[f"target_{name}"])
        for key in before:
            if key.endswith(("running_mean", "batches")):
                assert (before[key] != 0).any() and (after[key] == 0).all()


class TestXQC(_Contract):
    def make_loss(self, **options: object) -> XQCLoss:
        return xqc(**options)


class TestXQCTD3(_Contract):
    def make_loss(self, **options: object) -> XQCTD3Loss:
        return xqc_td3(**options)


# ---------------------------------------------------------------------- the projection


def projected_one_by_one(probabilities: list[float], values: list[float], support: list[float]) -> list[float]:
    """Algorithm 1 of Bellemare et al. (2017), in Python's numbers."""
    gap, shares = support[1] - support[0], [0.0] * len(support)
    for probability, value in zip(probabilities, values, strict=True):
        place = (min(max(value, support[0]), support[-1]) - support[0]) / gap
        lower = math.floor(place)
        if lower == place:
            shares[lower] += probability
        else:
            shares[lower] += probability * (lower + 1 - place)
            shares[lower + 1] += probability * (place - lower)
    return shares


def test_the_projection_is_that_of_c51() -> None:
    """Also of values that are clipped, lie on an atom or coincide, in any shape."""
    torch.manual_seed(0)
    support = torch.linspace(-3.0, 5.0, 17, dtype=torch.float64)
    probabilities = torch.rand(4, 5, 9, dtype=torch.float64).softmax(-1)
    values = 6 * torch.randn(4, 5, 9, dtype=torch.float64)
    values[0, 0] = support[:9]
    values[1, 1] = 2.2
    found = project_distribution(probabilities, values, support)
    for i, j in itertools.product(range(4), range(5)):
        expected = projected_one_by_one(probabilities[i, j].tolist(), values[i, j].tolist(), support.tolist())
        torch.testing.assert_close(found[i, j], torch.tensor(expected, dtype=torch.float64))
    torch.testing.assert_close(found.sum(-1), torch.ones(4, 5, dtype=torch.float64))
    inside = values.clamp(-3.0, 5.0)
    torch.testing.assert_close((found * support).sum(-1), (probabilities * inside).sum(-1))


@pytest.mark.parametrize("shapes", [((3, 4), (4, 3), (5,)), ((3, 4), (3, 4), (1,)), ((3, 4), (3, 4), (2, 2))])
def test_shapes_that_do_not_fit_are_refused(shapes: tuple[tuple[int, ...], ...]) -> None:
    with pytest.raises(ValueError, match="reshape them"):
        project_distribution(*(torch.zeros(shape) for shape in shapes))


def test_the_smallest_mean_is_found_for_each_sample() -> None:
    support = torch.tensor([0.0, 1.0, 2.0])
    first, second = torch.eye(3)[[0, 2]], torch.eye(3)[[1, 1]]
    assert least_valued(torch.stack([first, second]), support).tolist() == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


# ---------------------------------------------------------------------- the critic


def test_the_critic_is_the_papers() -> None:
    """Batch normalisation, then dense layers of rows of norm 1 without bias, normalised before their ReLU."""
    critic = CategoricalCritic(6, 2, (16, 8), atoms=21, momentum=0.25)
    layers = [type(layer) for layer in critic.net]
    hidden = [UnitNormLinear, BatchRenorm, nn.ReLU]
    assert layers == [BatchRenorm, *hidden, *hidden, UnitNormLinear]
    dense = [layer for layer in critic.net if isinstance(layer, UnitNormLinear)]
    assert [layer.bias is None for layer in dense] == [True, True, False]
    rows, weights = torch.randn(32, 8), dict(critic.named_parameters())
    for layer in dense:
        torch.testing.assert_close(layer.weight.norm(dim=-1), torch.ones(layer.out_features))
    theirs = nn.Sequential(
        *(nn.BatchNorm1d(layer.weight.shape[0], eps=1e-3, momentum=0.25) if type(layer) is BatchRenorm else layer
          for layer in copy.deepcopy(critic.net))
    )  # fmt: skip
    for _ in range(3):
        torch.testing.assert_close(critic(rows[:, :6], rows[:, 6:]), theirs(rows))
    torch.testing.assert_close(critic.eval()(rows[:, :6], rows[:, 6:]), theirs.eval()(rows))
    assert "net.1.bias" not in weights and not weights["net.7.bias"].any()


@BOTH
def test_stacked_critics_are_those_one_by_one(make: type) -> None:
    torch.manual_seed(0)
    loss, data = make(), batch()
    alone = [critic.module for critic in categorical()]
    for index, one in enumerate(alone):
        stored = loss.qvalue_network_params[index]["module"].flatten_keys(".")
        one.load_state_dict({key: value.detach().clone() for key, value in stored.items()})
    expected = torch.stack([one(data["observation"], data["action"]) for one in alone])
    torch.testing.assert_close(loss._logits(data, loss.qvalue_network_params), expected)
    means = (expected.softmax(-1) * torch.linspace(-5.0, 5.0, 21)).sum(-1)
    for one in alone:
        one.eval()
    torch.testing.assert_close(loss._values(data, loss.qvalue_network_params), means)


@BOTH
def test_the_actor_climbs_the_mean_by_running_statistics_and_leaves_them(make: type) -> None:
    loss, data = make(), batch()
    loss.value_loss(data)
    before = statistics(loss)
    acted = loss.act(data).detach()
    logits = []
    for index in range(2):
        one = CategoricalCritic(6, 2, (8, 8), atoms=21)
        stored = loss.qvalue_network_params[index]["module"].flatten_keys(".")
        one.load_state_dict({key: value.detach().clone() for key, value in stored.items()})
        logits.append(one.eval()(acted["observation"], acted["action"]))
    means = (torch.stack(logits).softmax(-1) * torch.linspace(-5.0, 5.0, 21)).sum(-1)
    torch.testing.assert_close(loss.action_value(acted), means[0] if make is xqc_td3 else means.amin(0))
    torch.testing.assert_close(loss.action_value(acted[:1]), loss.action_value(acted)[:1])
    assert loss.action_value(acted, target=True).shape == (12,)
    loss.actor_loss(data)[0].backward()
    torch.testing.assert_close(statistics(loss), before, atol=0, rtol=0)
    loss.value_loss(data)
    assert not any(torch.equal(one, other) for one, other in zip(statistics(loss), before, strict=True))
    before = statistics(loss)
    loss.eval().value_loss(data)
    torch.testing.assert_close(statistics(loss), before, atol=0, rtol=0)


# ---------------------------------------------------------------------- the critics' loss


@pytest.mark.parametrize("steps", [None, 3])
@BOTH
def test_the_loss_is_the_cross_entropy_with_the_shifted_distribution(make: type, steps: int | None) -> None:
    """By PyTorch's BatchNorm1d over both states, Python's loops and the target critics, which have other weights."""
    torch.manual_seed(0)
    loss = make(gamma=0.9, **({"policy_noise": 0.0} if make is xqc_td3 else {"alpha_init": 0.3, "fixed_alpha": True}))
    data = batch()
    if steps is not None:
        data["steps_to_next_obs"] = torch.full((12, 1), steps)
    for value in loss.target_qvalue_network_params.values(True, True):
        if value.dtype.is_floating_point:
            value.data.mul_(1 + 0.5 * torch.rand_like(value))
    torch.manual_seed(3)
    if make is xqc:
        following, log_prob = loss._acted_next(data)
    else:
        following, log_prob = loss._acted_next(data), torch.zeros(12)
    rows = torch.cat([torch.cat([each["observation"], each["action"]], -1) for each in (data, following)])

    def logits(params: TensorDict) -> tuple[Tensor, Tensor]:
        weights, hidden = params["module", "net"], rows
        for norm, dense in (("0", "1"), ("2", "4"), ("5", "7")):
            scale, shift = (weights[norm, name] for name in ("weight", "bias"))
            hidden = nn.functional.batch_norm(hidden, None, None, scale, shift, training=True, eps=1e-3)
            hidden = (hidden if norm == "0" else hidden.relu()) @ weights[dense, "weight"].T
        return (hidden + weights["7", "bias"]).chunk(2)

    now = [logits(loss.qvalue_network_params[index])[0].log_softmax(-1) for index in range(2)]
    then = [logits(loss.target_qvalue_network_params[index])[1].softmax(-1) for index in range(2)]
    support = [-5 + index / 2 for index in range(21)]
    discount, expected, means = 0.9 ** (steps or 1), 0.0, []
    for row in range(12):
        lower = min(then, key=lambda each: sum(p * z for p, z in zip(each[row].tolist(), support, strict=True)))
        going = 0.0 if data["next", "terminated"][row] else discount
        cost = 0.3 * log_prob[row].item()
        values = [data["next", "reward"][row].item() + going * (z - cost) for z in support]
        target = projected_one_by_one(lower[row].tolist(), values, support)
        means.append(sum(p * z for p, z in zip(target, support, strict=True)))
        expected -= sum((torch.tensor(target) * each[row]).sum() for each in now)
    torch.manual_seed(3)
    found, metadata = loss.value_loss(data)
    torch.testing.assert_close(found, expected / 12)
    torch.testing.assert_close(metadata["target_value"], torch.tensor(means))
    errors = torch.stack([each.exp() @ torch.tensor(support) for each in now]) - torch.tensor(means)
    torch.testing.assert_close(metadata["td_error"], errors.square())
    weight = loss.qvalue_network_params["module", "net", "1", "weight"]
    (by_hand,) = torch.autograd.grad(expected / 12, weight)
    torch.testing.assert_close(torch.autograd.grad(found, weight)[0], by_hand)


@BOTH
def test_the_critics_learn_a_reward(make: type) -> None:
    torch.manual_seed(0)
    loss, data = make(gamma=0.0), batch(64)
    data["next", "reward"] = data["action"][:, :1].clone()
    stepper = ActorCriticStepper(loss, execution="captured", critic_lr=1e-2)
    errors = []
    for _ in range(200):
        stepper.step(None, data)
        errors.append(loss.value_loss(data)[1]["td_error"].mean().item())
    assert errors[0] > 0.5 and errors[-1] < 0.2 * errors[0]


@BOTH
def test_what_is_no_such_loss_is_refused(make: type) -> None:
    with pytest.raises(UavrlError, match=r"min_value must be below max_value, got 1\.0 and 1\.0"):
        make(min_value=1.0, max_value=1.0)
    with pytest.raises(UavrlError, match="leave loss_function out"):
        make(loss_function="l2")
    policy = actor() if make is xqc_td3 else stochastic_actor()
    scalar = {xqc: XQCLoss, xqc_td3: XQCTD3Loss}[make](policy, critics(), action_spec=SPEC)
    with pytest.raises(UavrlError, match=r"needs critics that give two logits or more.*CategoricalCritic"):
        scalar.value_loss(batch())


@BOTH
def test_returns_beyond_the_support_are_told_once(make: type, caplog: pytest.LogCaptureFixture) -> None:
    """Below an actor penalty, too; the last reward of an episode counts less in its first state."""
    loss = PENALTIES["action rate"](make(gamma=0.5, min_value=-1.0, max_value=6.0))
    done = torch.tensor([False, False, True, False, True])[:, None]

    def episodes(*rewards: float) -> TensorDict:
        return TensorDict({"next": {"reward": torch.tensor(rewards)[:, None], "done": done}}, [5])

    with caplog.at_level(logging.WARNING):
        loss.observe(episodes(1.0, 2.0, 4.0, 4.0, 2.0))
        assert not caplog.records
        for _ in range(2):
            loss.observe(episodes(1.0, 2.0, 4.0, -3.0, 2.0))
    (record,) = caplog.records
    assert "-2 at the least and 4 at the most" in record.message and "from -1 to 6 only" in record.message


# ---------------------------------------------------------------------- updates


def row_norms(loss: ActorCriticLoss) -> list[Tensor]:
    found = loss.unwrapped.critic_network_params.flatten_keys(".").items()
    return [value.norm(dim=-1) for key, value in found if key.endswith((".1.weight", ".4.weight", ".7.weight"))]


@pytest.mark.parametrize("wrapped", [False, True])
@BOTH
def test_captured_updates_are_eager_ones_bit_for_bit_and_rows_keep_their_norm(make: type, wrapped: bool) -> None:
    """With the statistics of critics and targets, in an actor penalty, too."""
    found, data = [], batch()
    data["demonstrator_action"] = data["action"].flip(-1)
    for execution in ("eager", "captured"):
        torch.manual_seed(0)
        loss = PENALTIES["imitation"](make()) if wrapped else make()
        stepper = ActorCriticStepper(loss, execution=execution, policy_delay=2, critic_lr=0.1)
        before = [value.clone() for value in loss.critic_network_params.values(True, True)]
        for _ in range(6):
            stepper.step(None, data.clone())
            for norms in row_norms(loss):
                torch.testing.assert_close(norms, torch.ones_like(norms))
        after = loss.critic_network_params.values(True, True)
        assert not any(torch.equal(one, other) for one, other in zip(before, after, strict=True))
        found.append({key: value for key, value in loss.state_dict().items() if not key.endswith("extra_state")})
        counts = [each for each in statistics(loss) if each.dtype == torch.int64]
        assert len(counts) == 6 and all(bool((each == 6).all()) for each in counts)
    assert [key for key in found[0] if not torch.equal(found[0][key], found[1][key])] == []


class UnitNormCritic(nn.Module):
    """A critic of somebody's, of which one layer keeps its norm."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.last = UnitNormLinear(8, 5), nn.Linear(5, 1)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return self.last(self.first(torch.cat([observation, action], -1)).relu())


def test_rows_keep_their_norm_with_any_algorithm() -> None:
    loss = TD3Loss(actor(), [TensorDictModule(UnitNormCritic(), *KEYS) for _ in range(2)], action_spec=SPEC)
    stepper = ActorCriticStepper(loss, critic_lr=0.1)
    stepper.step(None, batch())
    weights = loss.qvalue_network_params["module"]
    torch.testing.assert_close(weights["first", "weight"].norm(dim=-1), torch.ones(2, 5))
    assert not torch.allclose(weights["last", "weight"].norm(dim=-1), torch.ones(2, 1), atol=1e-3)


def test_rows_keep_their_norm_by_a_hook_of_any_optimiser() -> None:
    loss = xqc()
    optimiser = torch.optim.SGD(loss.qvalue_network_params.parameters(), lr=1.0)
    optimiser.register_step_post_hook(lambda *_: loss.project_weights())
    before = loss.qvalue_network_params["module", "net", "1", "weight"].clone()
    loss.value_loss(batch())[0].backward()
    optimiser.step()
    assert not torch.allclose(loss.qvalue_network_params["module", "net", "1", "weight"], before)
    for norms in row_norms(loss):
        torch.testing.assert_close(norms, torch.ones_like(norms))


def test_other_critics_are_left_as_they_are() -> None:
    loss = td3()
    before = copy.deepcopy(loss.state_dict())
    loss.project_weights()
    torch.testing.assert_close(dict(loss.state_dict()), dict(before), atol=0, rtol=0)


# ---------------------------------------------------------------------- runs


SMALL_CRITIC = ["algo.critic.hidden=[16,16]", "algo.critic.atoms=11"]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (
            ["+algo.layer_norm=true"],
            r"algo\.layer_norm must be false with uavrl\.models\.categorical\.CategoricalCritic",
        ),
        (["recurrent=gru", "perception.frames=1"], r"algo must be td3 or sac with"),
        (["+algo.critic_reads=[wind]"], r"algo must be td3 or sac with"),
        (["algo.min_value=500"], r"^algo\.min_value must be below max_value, got 500"),
    ],
)
def test_what_does_not_fit_is_refused(more: list[str], sentence: str, tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "algo=xqc_td3", *more, *SMALL_CRITIC)
    with pytest.raises(UavrlError, match=sentence):
        build_trainer(validate(config), config, create_run(config))
