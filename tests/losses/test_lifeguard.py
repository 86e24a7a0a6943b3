from __future__ import annotations

import copy
import warnings
from typing import ClassVar

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer

from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.losses import episodes, lifeguard, sampler, td3, trained
from uavrl.losses import ActorCriticLoss, LifeGuard
from uavrl.losses.actor_penalty import any_number


class _Contract(ActorCriticLossContract):
    """The contract of a LifeGuard around TD3 whose penalty is active; the critic's loss is the base's."""

    settings: ClassVar[dict[str, object]] = {}

    def make_loss(self, **kwargs: object) -> LifeGuard:
        loss = trained(lifeguard(td3(**kwargs), **self.settings))
        loss.zero_grad()
        return loss

    def make_data(self, dtype: torch.dtype = torch.float32, size: int = 5) -> TensorDict:
        data = super().make_data(dtype, size)
        data["next", "collided"] = data["next", "terminated"].clone()
        return data


class TestLinearOnTD3(_Contract):
    def test_no_optimiser_moves_its_weights(self) -> None:
        loss = self.make_loss()
        assert not loss.model_params
        assert not loss.lifeguard_loss(self.make_data())[0].requires_grad


class TestMLPOnTD3(_Contract):
    compiled: ClassVar[tuple[str, ...]] = ("actor_loss",)
    methods: ClassVar[dict[str, str]] = _Contract.methods | {"lifeguard_loss": "model"}
    settings: ClassVar[dict[str, object]] = {"model": "mlp", "model_lr": 1e-2}


class TestLabelOnTD3(_Contract):
    settings: ClassVar[dict[str, object]] = {"penalty": "label"}


def actor_gradient(loss: ActorCriticLoss, data: TensorDict) -> list[torch.Tensor]:
    params = [p for p in loss.actor_network_params.values(True, True) if p.requires_grad]
    return list(torch.autograd.grad(loss.actor_loss(data)[0], params))


class TestActorTerm:
    @pytest.mark.parametrize("model", ["linear", "mlp"])
    def test_labels_leave_the_gradient_of_td3_and_probabilities_do_not(self, model: str) -> None:
        torch.manual_seed(0)
        base = td3()
        loss = trained(lifeguard(base, model=model, penalty="label", model_lr=1e-2))
        data = episodes(4)
        plain, label = actor_gradient(base, data), actor_gradient(loss, data)
        assert all(torch.equal(one, other) for one, other in zip(plain, label, strict=True))
        assert loss.actor_loss(data)[0] > base.actor_loss(data)[0]  # the loss itself is not the same
        numbers = loss.diagnostics()
        assert numbers["lifeguard_penalty"] > 0.0 == numbers["lifeguard_gradient"]
        loss.penalty = "probability"
        assert not all(torch.equal(one, other) for one, other in zip(plain, actor_gradient(loss, data), strict=True))

    @pytest.mark.parametrize(("model", "one_direction"), [("linear", True), ("mlp", False)])
    def test_a_linear_classifier_pushes_every_action_the_same_way(self, model: str, one_direction: bool) -> None:
        torch.manual_seed(0)
        loss = trained(lifeguard(model=model, model_lr=1e-2))
        torch.manual_seed(1)
        action = (4 * torch.rand(64, 2) - 2).requires_grad_()
        acted = TensorDict({"observation": 3 * torch.rand(64, 6), "action": action}, [64])
        term, _ = loss.actor_term(acted)
        (gradient,) = torch.autograd.grad(term.double().sum(), action)
        directions = torch.nn.functional.normalize(gradient[gradient.norm(dim=-1) > 1e-12].double(), dim=-1)
        assert len(directions) > 10
        cosine = directions @ directions[0]
        assert bool((cosine > 1 - 1e-6).all()) == one_direction

    def test_literal_value(self) -> None:
        """Scaled features (0.5, 0, 0, 1, 0), w = (4, 0, 0, -2, 0), j = 0: the logit is 0 and c is a half."""
        loss = lifeguard(penalty_weight=8.0)
        loss.classifier.scaler.low.copy_(torch.tensor([0.0, 5.0, 0.0, -2.0, -2.0]))
        loss.classifier.scaler.high.copy_(torch.tensor([2.0, 5.0, 1.0, 2.0, 2.0]))
        loss.classifier.model.weight.copy_(torch.tensor([4.0, 0.0, 0.0, -2.0, 0.0]))
        loss._active = True
        state = torch.tensor([[9.0, 9.0, 9.0, 1.0, 5.0, 0.0]])
        action = torch.tensor([[2.0, -2.0]], requires_grad=True)
        term, _ = loss.actor_term(TensorDict({"observation": state, "action": action}, [1]))
        assert term.tolist() == [4.0]
        (gradient,) = torch.autograd.grad(term.sum(), action)  # 8 · ¼ · (-2) / 4
        assert gradient.tolist() == [[-1.0, 0.0]]


class TestObserve:
    def test_stores_the_last_transition_of_each_collision_unscaled(self) -> None:
        loss = lifeguard()
        crashes, others = episodes(3), episodes(2, collided=False)
        loss.observe(torch.cat([others, crashes, others]))
        expected = torch.cat([crashes["observation"][4::5, 3:], crashes["action"][4::5]], -1)
        assert torch.equal(loss.collisions[:], expected)

    def test_equal_stores_are_saved_as_equal_bytes(self) -> None:
        """Rows that hold nothing yet are saved, too."""
        data = episodes(3)
        loss, other = lifeguard(capacity=1000), lifeguard(capacity=1000)
        for one in (loss, other):
            one.observe(data)
        saved = [one.get_extra_state()["collisions"]["_storage"]["_storage"] for one in (loss, other)]
        assert torch.equal(*saved)
        assert saved[0].shape == (1000, 5) and not saved[0][3:].any()

    def test_the_store_is_bounded(self) -> None:
        loss = lifeguard(capacity=7)
        loss.observe(episodes(5))
        last = episodes(5)
        loss.observe(last)
        stored = {tuple(row) for row in loss.collisions[:].tolist()}
        newest = torch.cat([last["observation"][4::5, 3:], last["action"][4::5]], -1)
        assert len(loss.collisions) == 7 and {tuple(row) for row in newest.tolist()} < stored

    def test_weight_falls_with_recent_success(self) -> None:
        loss = lifeguard(success_window=4)
        assert float(loss.weight) == 10.0
        loss.observe(torch.cat([episodes(3), episodes(1, collided=False, arrived=True)]))
        assert float(loss.weight) == 7.5
        loss.observe(episodes(3, collided=False, arrived=True))
        assert float(loss.weight) == 0.0

    def test_without_a_success_flag(self) -> None:
        loss = lifeguard(success_window=None)
        loss.observe(episodes(2).exclude(("next", "arrived")))
        assert float(loss.weight) == 10.0
        with pytest.raises(KeyError, match="success_window=None"):
            lifeguard().observe(episodes(2).exclude(("next", "arrived")))

    def test_keys_can_be_renamed(self) -> None:
        data = episodes(2)
        loss = lifeguard()
        loss.observe(data)
        renamed = lifeguard()
        renamed.set_keys(collided="crash", arrived="won")
        for old, new in (("collided", "crash"), ("arrived", "won")):
            data["next", new] = data["next"].pop(old)
        renamed.observe(data)
        assert torch.equal(loss.collisions[:], renamed.collisions[:])
        assert ("next", "crash") in renamed.in_keys
        full = lifeguard()
        full.set_keys(collided=("next", "crash"), arrived=("next", "won"))
        full.observe(data)
        assert torch.equal(loss.collisions[:], full.collisions[:]), "full keys mean the same"
        told = r"LifeGuard reads \('next', 'collided'\), but .*'crash'.*set_keys\(collided="
        with pytest.raises(KeyError, match=told):
            lifeguard().observe(data)
        with pytest.raises(ValueError, match="Expected keys out of"):
            loss.set_keys(colided="crash")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                lambda data: data.set("observation", torch.full((10, 6), torch.nan)),
                "Expected finite states and actions",
            ),
            (lambda data: data.set("action", torch.full((10, 2), torch.inf)), "Expected finite states and actions"),
            (lambda data: data[:-1], "got 9 steps, and the last one does not end an episode: collect with"),
            (lambda data: data.set("action", torch.zeros(10, 4)), "check observations= and actions="),
        ],
    )
    def test_other_data_is_refused_and_leaves_no_trace(self, change: object, message: str) -> None:
        loss = lifeguard()
        with pytest.raises(ValueError, match=message):
            loss.observe(change(episodes(2)))
        assert len(loss.collisions) == 0
        assert loss.classifier.scaler.low.isinf().all()


class TestFit:
    @pytest.mark.parametrize("batch_size", [16, None])
    def test_it_draws_from_a_buffer_of_any_batch_size_without_a_warning(self, batch_size: int | None) -> None:
        """By ``buffer.sample``, as the documentation has it; other functions are called as they are."""
        buffer = ReplayBuffer(storage=LazyTensorStorage(200), batch_size=batch_size)
        data = episodes(12)
        buffer.extend(data)
        loss = lifeguard(min_collisions=1)
        loss.observe(data)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*conflicting batch_sizes")
            loss.fit(buffer.sample, 5)
        assert loss.evaluated == 1
        assert any_number(buffer.sample)(7).batch_size == (7,)

    @pytest.mark.parametrize("model", ["linear", "mlp"])
    def test_without_collisions_nothing_happens(self, model: str) -> None:
        loss = lifeguard(model=model)
        data = episodes(20, collided=False)
        before = copy.deepcopy(loss.classifier.model.state_dict())
        loss.observe(data)
        loss.fit(sampler(data), 5, loss.make_optimizer())
        assert loss.evaluated == 0
        assert all(torch.equal(value, before[name]) for name, value in loss.classifier.model.state_dict().items())
        rates = {f"lifeguard_{a}_{b}_rate": 0.0 for a in ("true", "false") for b in ("positive", "negative")}
        others = ("lifeguard_active", "lifeguard_collisions", "lifeguard_penalty", "lifeguard_gradient")
        assert loss.diagnostics() == rates | dict.fromkeys(others, 0.0) | {"lifeguard_weight": 10.0}

    def test_training_starts_with_more_than_min_collisions(self) -> None:
        loss, data = lifeguard(min_collisions=4), episodes(4)
        loss.observe(data)
        loss.fit(sampler(data), 1)
        assert int(loss.classifier.model.t) == 0
        loss.observe(episodes(1))
        loss.fit(sampler(data), 3)
        assert int(loss.classifier.model.t) == 3 * 20

    def test_batches_are_balanced_and_shuffled(self) -> None:
        loss = lifeguard()
        data = episodes(10)
        loss.observe(data)
        seen: list[torch.Tensor] = []

        def partial_fit(x: torch.Tensor, y: torch.Tensor) -> None:
            assert (x.amin() >= 0) & (x.amax() <= 1)
            scaled = loss.classifier.scaler(loss.collisions[:])
            is_stored = (x[:, None] == scaled).all(-1).any(-1)
            assert torch.equal(is_stored, y)
            seen.append(y)

        loss.classifier.model.partial_fit = partial_fit
        loss.fit(sampler(data), 30)
        labels = seen[0].unflatten(0, (30, 20))
        assert (labels.sum(-1) == 10).all()
        assert len({tuple(row) for row in labels.tolist()}) > 20

    def test_evaluates_before_it_trains(self) -> None:
        """An untrained classifier predicts no collision: no positive, true or false."""
        loss, data = lifeguard(), episodes(10)
        loss.observe(data)
        loss.fit(sampler(data), 50)
        assert list(loss.evaluations) == [[0, 0, 10, 10]]
        loss.evaluate(data[torch.arange(10)])
        assert loss.evaluated == 2

    @pytest.mark.parametrize(
        ("false_positives", "evaluations", "active"),
        [(3, 20, False), (3, 21, True), (4, 21, False), (4, 1000, False), (0, 0, False)],
    )
    def test_it_is_trusted(self, false_positives: int, evaluations: int, active: bool) -> None:
        """Of 100 negatives: a rate of 0.97 is enough, 0.96 is not; 20 evaluations are not enough, 21 are."""
        loss = lifeguard(min_evaluations=20, min_true_negative_rate=0.96)
        loss.evaluations.extend([[0, false_positives, 100 - false_positives, 100]] * min(evaluations, 1))
        loss.evaluated = evaluations
        loss._refresh()
        assert loss.active is active

    def test_false_alarms_deactivate_the_penalty(self) -> None:
        loss, others = lifeguard(evaluation_window=3), episodes(2, collided=False)
        loss.observe(episodes(1))
        for _ in range(3):
            loss.evaluate(others)
        assert loss.active
        loss.classifier.model.intercept.fill_(1.0)
        loss.evaluate(others)
        assert not loss.active
        assert loss.diagnostics()["lifeguard_false_positive_rate"] == pytest.approx(1 / 3)

    def test_few_large_draws(self) -> None:
        """150 steps of 50 others come in one draw; none is larger than the bound."""
        loss = lifeguard(batch_size=100)
        data = episodes(10)
        loss.observe(data)
        sizes: list[int] = []

        def sample(n: int) -> TensorDict:
            sizes.append(n)
            return data[~data["next", "collided"].squeeze(-1)][torch.randint(40, (n,))]

        loss.fit(sample, 100)
        assert len(sizes) == 1
        loss.fit(sample, 500)
        assert max(sizes) <= 8192

    @pytest.mark.parametrize(
        ("model", "call", "message"),
        [
            ("linear", lambda loss, data: loss.fit(lambda n: data[4::5][torch.randint(10, (n,))], 5), "not collide"),
            ("linear", lambda loss, data: loss.evaluate(data), "Expected 10 transitions"),
            ("linear", lambda loss, data: lifeguard().evaluate(data[:10]), "found none"),
            ("mlp", lambda loss, data: loss.fit(sampler(data), 5), "see make_optimizer"),
        ],
    )
    def test_what_it_cannot_learn_from_is_refused(self, model: str, call: object, message: str) -> None:
        loss, data = lifeguard(model=model), episodes(10)
        loss.observe(data)
        with pytest.raises(ValueError, match=message):
            call(loss, data)

    def test_a_module_of_ones_own(self) -> None:
        class Own(torch.nn.Module):
            def __init__(self) -> None:
                super().__init__()
                self.layer = torch.nn.Linear(5, 1)

            def forward(self, x: torch.Tensor) -> torch.Tensor:
                return self.layer(x)[..., 0]

        trained(lifeguard(model=Own(), model_lr=1e-1), 20)

    @pytest.mark.parametrize("model", ["linear", "mlp"])
    def test_continues_from_its_state_as_if_never_stopped(self, model: str) -> None:
        torch.manual_seed(0)
        one = trained(lifeguard(model=model, model_lr=1e-2))
        first = one.make_optimizer()
        other = lifeguard(model=model, model_lr=1e-2)
        other.load_state_dict(copy.deepcopy(one.state_dict()))
        second = other.make_optimizer()
        assert other.active
        data = episodes(10)
        for loss, optimizer in ((one, first), (other, second)):
            torch.manual_seed(1)
            loss.observe(data)
            loss.fit(sampler(data), 20, optimizer)
        states = one.state_dict(), other.state_dict()
        extra = [state.pop("_extra_state") for state in states]
        assert all(torch.equal(value, states[1][name]) for name, value in states[0].items())
        assert torch.equal(one.collisions[:], other.collisions[:])
        assert torch.equal(extra[0]["evaluations"], extra[1]["evaluations"])
        assert one.diagnostics() == other.diagnostics()
        assert torch.equal(one.actor_loss(data)[0], other.actor_loss(data)[0])


def test_diagnostics_agree_with_autograd_through_the_actor_term() -> None:
    loss, data = trained(lifeguard(model="mlp", model_lr=1e-2)), episodes(1)
    loss.observe(data)
    action = data["action"].clone().requires_grad_()
    term, _ = loss.actor_term(data.set("action", action))
    (gradient,) = torch.autograd.grad(term.sum(), action)
    numbers = loss.diagnostics()
    assert numbers["lifeguard_penalty"] == pytest.approx(float(term.detach().mean()))
    assert numbers["lifeguard_gradient"] == pytest.approx(float(gradient.norm(dim=-1).mean()))
    assert numbers["lifeguard_active"] == 1.0


@pytest.mark.parametrize("model", ["linear", "mlp"])
def test_the_type_of_the_actor_and_not_of_the_host_decides(model: str) -> None:
    base, data = td3(), episodes(10)
    torch.set_default_dtype(torch.float64)
    try:
        loss = lifeguard(base, model=model)
        loss.observe(data)
        loss.fit(sampler(data), 5, loss.make_optimizer())
        loss._active = True
        value, _ = loss.actor_loss(data)
        value.backward()
    finally:
        torch.set_default_dtype(torch.float32)
    assert value.dtype == torch.float32
    assert all(p.grad.dtype == torch.float32 for p in base.actor_network_params.values(True, True))


def test_one_lifeguard_on_another() -> None:
    inner = trained(lifeguard(model="mlp", model_lr=1e-2))
    outer = lifeguard(inner, penalty_weight=3.0)
    data = episodes(10)
    torch.testing.assert_close(outer.actor_loss(data)[0], inner.actor_loss(data)[0])
    trained(outer)
    assert [one.active for one in outer.penalties] == [True, True]
    assert len(inner.collisions) == 160  # the outer one passes episodes on
    assert outer.actor_loss(data)[0] > inner.actor_loss(data)[0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"model": "tree"}, "model must be"),
        ({"penalty": "hinge"}, "penalty must be"),
        ({"batch_size": 5}, "even"),
        ({"stacked": 4}, "cannot be split into stacked=4"),
        ({"stacked": 0}, "cannot be split into stacked=0"),
    ],
)
def test_unknown_settings_are_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        lifeguard(**settings)
