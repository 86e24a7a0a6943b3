"""LifeGuard (Chansuparp (2022), §3.5): a collision classifier that restrains the actor."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.func import functional_call
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.objectives import LossModule

from uavrl.entries import MissingEntry, after_step, require_whole
from uavrl.losses.actor_penalty import ActorPenalty, AuxiliaryModel, Sample, any_number
from uavrl.models.collision import CollisionClassifier, confusion_rates
from uavrl_onboard.ranges import Count, Discount, NonNegative, Pairs, Positive, Whole

_CHUNK = 8192  # transitions drawn at once: bounds the memory, a thousand bytes each


class LifeGuard(ActorPenalty):
    """Adds ``p_cp c(o, μ(s))`` to the actor's objective: c predicts that the action collides (Eq. 3.7-3.11).

    Call :meth:`observe` and then :meth:`fit` once for each episode. The classifier reads the last observation in the
    state and the action, each scaled to (0, 1) by the range seen so far. It learns from the last transition before each
    collision and from as many other transitions. Each episode evaluates it before it trains it; the penalty is active
    after more than ``min_evaluations`` evaluations, while the true-negative rate is above ``min_true_negative_rate``.

    Args:
        base: the loss to add the term to.
        observations: width of the whole state, with all ``stacked`` observations.
        actions: width of the action.
        model: ``"linear"`` (the thesis), ``"mlp"``, or a module that takes features ``[*B, observations + actions]``
            to logits ``[*B]``. A linear one pushes every action the same way, whatever the observation.
        penalty: ``"probability"``, differentiable in the action, or ``"label"`` (1 if c > 0.5), a constant, as the
            author's published code has it: the actor's gradient is then exactly that of ``base``.
        penalty_weight: p_cp.
        success_window: recent episodes whose success rate lowers the weight to ``p_cp (1 - success rate)``; None keeps
            it at p_cp and never reads ``arrived``.
        capacity: stored collisions; the oldest are replaced.
        batch_size: rows of a training batch, half of them collisions.
        min_collisions: training starts with more stored collisions than these.
        min_evaluations: see above.
        evaluation_window: recent evaluations that the true-negative rate covers.
        min_true_negative_rate: see above.
        model_lr: Adam's step for a model with parameters.
        alpha: α of Eq. 3.8.
        stacked: observations that are stacked in the state.

    Raises:
        ValueError: for an unknown model or penalty, or an odd batch size.

    Examples:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from uavrl.losses import DDPGLoss
        >>> from uavrl.models import Actor, Critic
        >>> critic = Mod(Critic(6, 4), ["observation", "action"], ["state_action_value"])
        >>> base = DDPGLoss(Mod(Actor(6, 4), ["observation"], ["action"]), critic)
        >>> loss = LifeGuard(base, observations=6, stacked=2, actions=4, min_collisions=0)
        >>> crash = TensorDict({"observation": torch.rand(2, 6), "action": torch.rand(2, 4), "next": {
        ...     "done": torch.tensor([[False], [True]]), "collided": torch.tensor([[False], [True]]),
        ...     "arrived": torch.zeros(2, 1, dtype=torch.bool)}}, [2])
        >>> loss.observe(crash)
        >>> loss.fit(lambda n: crash[torch.randint(2, (n,))], steps=2, optimizer=loss.make_optimizer())
        >>> int(loss.diagnostics()["lifeguard_collisions"]), loss.active
        (1, False)
    """

    @dataclass
    class _AcceptedKeys(ActorPenalty._AcceptedKeys):
        """The keys that LifeGuard reads of a transition; ``collided``, ``arrived``, ``done`` under ``"next"``."""

        observation: NestedKey = "observation"
        action: NestedKey = "action"
        collided: NestedKey = "collided"
        arrived: NestedKey = "arrived"
        done: NestedKey = "done"

    default_keys = _AcceptedKeys
    computed: ClassVar[Mapping[str, str]] = {"weight": "penalty_weight and the success rate"}

    weight: Tensor

    def __init__(
        self,
        base: LossModule,
        *,
        observations: int,
        actions: int,
        model: Literal["linear", "mlp"] | nn.Module = "linear",
        penalty: Literal["probability", "label"] = "probability",
        penalty_weight: NonNegative = 10.0,
        success_window: Count | None = 100,
        capacity: Count = 10_000,
        batch_size: Pairs = 100,
        min_collisions: Whole = 50,
        min_evaluations: Whole = 20,
        evaluation_window: Count = 100,
        min_true_negative_rate: Discount = 0.96,
        model_lr: Positive = 1e-3,
        alpha: Positive = 1e-4,
        stacked: Count = 1,
    ) -> None:
        if penalty not in ("probability", "label"):
            raise ValueError(f'penalty must be "probability" or "label", got {penalty!r}.')
        if batch_size < 2 or batch_size % 2:
            raise ValueError(f"batch_size must be even, half of it collisions, got {batch_size}.")
        if stacked < 1 or observations < 1 or observations % stacked:
            raise ValueError(
                f"A state of observations={observations} numbers cannot be split into stacked={stacked} observations "
                f"of equal width: observations= is the width of the whole state, and stacked= how many it holds."
            )
        super().__init__(base)
        self.observations, self.actions = observations // stacked, actions
        self.penalty: str = penalty
        self.penalty_weight, self.batch_size, self.model_lr = penalty_weight, batch_size, model_lr
        self.min_collisions, self.min_evaluations = min_collisions, min_evaluations
        self.min_true_negative_rate = min_true_negative_rate
        self.classifier = CollisionClassifier(self.observations + actions, model, alpha)
        self.collisions = ReplayBuffer(storage=LazyTensorStorage(capacity, device="cpu"))
        actor = next(iter(base.actor_network_params.values(True, True)))
        self._dtype = actor.dtype  # of the features; the host's default may be another
        empty = torch.zeros(capacity, self.observations + actions, dtype=self._dtype)
        self.collisions.extend(empty)  # checkpoints save empty rows, too
        self.collisions.empty()
        self.evaluations: deque[list[int]] = deque(maxlen=evaluation_window)  # confusion counts of the last ones
        self.evaluated = 0  # number of evaluations so far
        self.successes = None if success_window is None else deque[float](maxlen=success_window)
        self.register_buffer("weight", torch.tensor(float(penalty_weight)))
        self.out_keys = [*self.out_keys, "loss_lifeguard"]
        self._active = False
        self._last_episode: Tensor | None = None
        self.classifier.scaler.to(self._dtype)
        if model == "mlp":
            self.classifier.model.to(self._dtype)
        self.to(actor.device)

    @property
    def active(self) -> bool:
        """Whether the penalty is part of the actor's objective."""
        return self._active

    def _refresh(self) -> None:
        """Computes the weight and :attr:`active`: to do so within the actor's loss would break a traced graph."""
        success = sum(self.successes) / len(self.successes) if self.successes else 0.0
        self.weight.fill_(self.penalty_weight * (1.0 - success))
        rate = confusion_rates(self._counts()).true_negative
        self._active = self.evaluated > self.min_evaluations and rate > self.min_true_negative_rate

    def _counts(self) -> Tensor:
        """The confusion counts ``[E, 4]`` of the last evaluations."""
        return torch.tensor([*self.evaluations], dtype=torch.int64).reshape(len(self.evaluations), 4)

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """``p_cp c(o, μ(s))`` (Eq. 3.11) of states with the actor's actions ``[*B]``."""
        term = self._charge(self._features(acted))
        return term, {"lifeguard_penalty": term.detach()}

    def _charge(self, features: Tensor) -> Tensor:
        """``p_cp c`` for features ``[*B, F]``; the classifier is constant."""
        constants = {name: p.detach() for name, p in self.classifier.named_parameters()}
        logit = functional_call(self.classifier, constants, (features,))
        c = (logit > 0).to(logit.dtype) if self.penalty == "label" else logit.sigmoid()
        return c * self.weight

    def _features(self, tensordict: TensorDictBase) -> Tensor:
        """``[*B, observations + actions]``: the last observation in the state, and the action."""
        keys = self.tensor_keys
        state, action = (tensordict.get(key, None) for key in (keys.observation, keys.action))
        if state is None or action is None:
            missing = "observation" if state is None else "action"
            raise self._missing(getattr(keys, missing), tensordict, missing)
        if state.shape[-1] < self.observations or action.shape[-1] != self.actions:
            raise ValueError(
                f"Expected a state of at least {self.observations} and an action of {self.actions} numbers, got "
                f"{state.shape[-1]} and {action.shape[-1]}: check observations= and actions= of LifeGuard."
            )
        return torch.cat([state[..., -self.observations :], action], -1)

    def _missing(self, key: NestedKey, tensordict: TensorDictBase, name: str, remedy: str = "") -> MissingEntry:
        """The error about an entry whose key :meth:`set_keys` sets by ``name``."""
        remedy = f"set the right key by set_keys({name}=KEY){remedy}"
        return MissingEntry(self, key, "the data contain", tensordict.keys(True, True), remedy)

    def _next(self, tensordict: TensorDictBase, name: str) -> Tensor:
        """The flag ``name`` after each step as bool ``[*B]``; its key may begin with ``"next"`` or leave it out."""
        key = after_step(getattr(self.tensor_keys, name))
        flag = tensordict.get(key, None)
        if flag is None:
            raise self._missing(key, tensordict, name, ", pass success_window=None" if name == "arrived" else "")
        return flag.reshape(tensordict.batch_size).bool()

    def reset_parameters_recursive(self) -> None:
        """As :meth:`ActorPenalty.reset_parameters_recursive`; the evaluations of the old classifier are forgotten."""
        super().reset_parameters_recursive()
        for module in reversed(list(self.classifier.modules())):  # the parts first, as TorchRL does
            reset = getattr(module, "reset_parameters", None)
            if callable(reset):
                reset()
        self.evaluations.clear()
        self.evaluated = 0
        self._refresh()

    @torch.no_grad()
    def observe(self, episodes: TensorDictBase) -> None:
        """Updates the features' range, the stored collisions and the success rate by whole episodes ``[T]``.

        Raises:
            ValueError: when they are not whole, or a number is not finite.
            KeyError: when a flag is missing.
        """
        super().observe(episodes)
        require_whole(self._next(episodes, "done"), flat=True)
        ends = self._next(episodes, "done").nonzero().squeeze(-1)
        features = self._known(episodes)
        if not features.isfinite().all():
            raise ValueError("Expected finite states and actions, got a NaN or an infinity: end the episode before it.")
        last = episodes[ends]
        collided = self._next(last, "collided")
        arrived = self._next(last, "arrived") if self.successes is not None else None
        self.classifier.scaler.update(features)
        if collided.any():
            self.collisions.extend(features[ends[collided]].to(self._dtype))
        self._last_episode = features[int(ends[-2]) + 1 if len(ends) > 1 else 0 :]
        if self.successes is not None and arrived is not None:
            self.successes.extend(arrived.float().tolist())
        self._refresh()

    def _known(self, transitions: TensorDictBase) -> Tensor:
        """The constant features of transitions, with the classifier's device and type."""
        return self._features(transitions).detach().to(self.classifier.scaler.low)

    def _draw_collisions(self, count: int) -> Tensor:
        """``[count, F]`` features of stored collisions, drawn with replacement."""
        if not len(self.collisions):
            raise ValueError("Expected stored collisions, found none: call observe() with episodes that collided.")
        return self.collisions.sample(count).to(self.classifier.scaler.low)

    def _draw_others(self, sample: Sample, count: int) -> Tensor:
        """``[count, F]`` features of random transitions that did not collide."""
        drawn: list[Tensor] = []
        sample = any_number(sample)
        missing = count
        for _ in range(10 + 10 * count // _CHUNK):
            batch = sample(min(missing + missing // 8 + 8, _CHUNK))
            others = ~self._next(batch, "collided")
            drawn.append(self._known(batch)[others][:missing])
            missing -= len(drawn[-1])
            if not missing:
                return torch.cat(drawn)
        raise ValueError(f"Expected {count} transitions that did not collide, found {count - missing} in many draws.")

    @property
    def model_params(self) -> list[Tensor]:
        """The classifier's parameters; none for the linear one, which has its own rule (Eq. 3.10)."""
        return list(self.classifier.parameters())

    @property
    def models(self) -> list[AuxiliaryModel]:
        """The classifier, trained after each episode."""
        return [AuxiliaryModel(parameters=self.model_params, lr=self.model_lr, on_episode=self.fit)]

    def make_optimizer(self) -> torch.optim.Optimizer | None:
        """Adam for :attr:`model_params`, or None without any. Keep it, and save it in your checkpoints."""
        return torch.optim.Adam(self.model_params, lr=self.model_lr, fused=True) if self.model_params else None

    def fit(self, sample: Sample, steps: int, optimizer: torch.optim.Optimizer | None = None) -> None:
        """Evaluates the classifier once, then trains it, if more than ``min_collisions`` collisions are stored.

        Args:
            sample: draws n random transitions ``[n]`` of the replay buffer; those that collided are left out.
            steps: training steps, as many as the episode had.
            optimizer: what :meth:`make_optimizer` returned.

        Raises:
            ValueError: when a model with parameters gets no optimiser, or nearly all transitions collided.
        """
        if optimizer is None and self.model_params:
            raise ValueError("Expected an optimiser for the classifier's parameters, got None: see make_optimizer().")
        if len(self.collisions) <= self.min_collisions or steps < 1:
            return
        half = self.batch_size // 2
        others = self._draw_others(sample, (steps + 1) * half)
        self._evaluate(others[:half])
        collisions = self._draw_collisions(steps * half).unflatten(0, (steps, half))
        rows = torch.cat([collisions, others[half:].unflatten(0, (steps, half))], 1)
        order = torch.rand(steps, 2 * half).argsort(-1).to(rows.device)
        self.classifier.fit(rows.gather(1, order[..., None].expand_as(rows)), order < half, optimizer)

    def evaluate(self, others: TensorDictBase) -> None:
        """Counts right and wrong predictions for ``[batch_size / 2]`` other transitions and as many random collisions.

        Raises:
            ValueError: for another number of transitions, or without a stored collision.
        """
        if tuple(others.batch_size) != (self.batch_size // 2,):
            raise ValueError(f"Expected {self.batch_size // 2} transitions, got {tuple(others.batch_size)}.")
        self._evaluate(self._known(others))

    def _evaluate(self, others: Tensor) -> None:
        half = len(others)
        features = torch.cat([self._draw_collisions(half), others])
        counts = self.classifier.evaluate(features, torch.arange(2 * half, device=features.device) < half)
        self.evaluations.append(counts.tolist())
        self.evaluated += 1
        self._refresh()

    def lifeguard_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The classifier's reduced training error (Eq. 3.8-3.9) on transitions ``[*B]``, and detached metadata.

        Raises:
            KeyError: when ``("next", "collided")`` is missing.
        """
        collided = self._next(tensordict, "collided")
        error = self.classifier.error(self._features(tensordict).detach(), collided)
        return self._reduced(error, tensordict), {"lifeguard_collided": collided.float().mean()}

    @property
    def in_keys(self) -> list[NestedKey]:
        """What :meth:`forward` reads."""
        keys = self.tensor_keys
        return list(dict.fromkeys([*self._inner.in_keys, keys.observation, keys.action, after_step(keys.collided)]))

    def model_losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """The classifier's loss."""
        return {"loss_lifeguard": self.lifeguard_loss(tensordict)[0]}

    def diagnostics(self) -> dict[str, float]:
        """The base's, and LifeGuard's.

        The rates cover the last evaluations; a collision is positive. ``lifeguard_penalty`` is the mean of ``p_cp c``
        over the steps of the last episode observed, ``lifeguard_gradient`` the mean norm of its gradient in the action;
        both are 0 while the penalty is not active.
        """
        rates = confusion_rates(self._counts())
        penalty, gradient = self._last_charge()
        return super().diagnostics() | {
            "lifeguard_active": float(self._active),
            **{f"lifeguard_{name}_rate": rate for name, rate in rates._asdict().items()},
            "lifeguard_collisions": float(len(self.collisions)),
            "lifeguard_weight": float(self.weight),
            "lifeguard_penalty": penalty,
            "lifeguard_gradient": gradient,
        }

    def _last_charge(self) -> tuple[float, float]:
        if not self._active or self._last_episode is None:
            return 0.0, 0.0
        with torch.enable_grad():
            features = self._last_episode.clone().requires_grad_()
            charge = self._charge(features)
            mean = float(charge.detach().mean())
            if not charge.requires_grad:
                return mean, 0.0
            (gradient,) = torch.autograd.grad(charge.sum(), features)
        return mean, float(gradient[:, -self.actions :].norm(dim=-1).mean())

    def get_extra_state(self) -> dict[str, Any]:
        """The collisions, evaluations and successes, for ``state_dict``."""
        return {
            "collisions": self.collisions.state_dict(),
            "evaluations": self._counts(),
            "evaluated": self.evaluated,
            "successes": torch.tensor(self.successes or [], dtype=torch.float64),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`get_extra_state` gave."""
        self.collisions.load_state_dict(state["collisions"])
        self.evaluations = deque(state["evaluations"].tolist(), self.evaluations.maxlen)
        self.evaluated = int(state["evaluated"])
        if self.successes is not None:
            self.successes = deque(state["successes"].tolist(), self.successes.maxlen)
        self._last_episode = None
        self._refresh()
