"""Behaviour cloning towards a scripted controller, while learning from rewards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import LossModule

from uavrl.errors import UavrlError
from uavrl.losses.actor_penalty import ActorPenalty
from uavrl_onboard.ranges import Count, NonNegative, Positive


def action_distance(action: Tensor, other: Tensor, limit: float) -> Tensor:
    """Mean squared difference ``[*B]`` of actions ``[*B, A]``, in units of the largest action.

    Examples:
        >>> import torch
        >>> action_distance(torch.tensor([2.0, 0.0]), torch.tensor([0.0, 0.0]), 2.0).item()
        0.5
    """
    return ((action - other) / limit).square().mean(-1)


def decayed(first: float, final: float | None, share: float) -> float:
    """A weight after a share of its geometric decay from ``first`` to ``final``; None: there is none.

    Examples:
        >>> [round(decayed(4.0, 0.25, share), 2) for share in (0.0, 0.5, 1.0, 2.0)]
        [4.0, 1.0, 0.25, 0.25]
    """
    share = min(share, 1.0)
    return first if final is None else first ** (1 - share) * final**share


class Imitation(ActorPenalty):
    """Adds the distance between the actor's action and that of a scripted controller g to the actor's objective.

    The term is ``weight · mean |objective| · ‖(μ(s) - g(s)) / limit‖² / A``, so that its share stays while values grow.
    The controller's action is recorded in the states that the policy reaches, too, not in its own episodes alone.
    The weight may decay, geometrically, so that the actor first clones and then leaves the controller behind.

    Source: Fujimoto and Gu (2021), A Minimalist Approach to Offline Reinforcement Learning (arXiv:2106.06860), Eq. 3
    and 5 with α = 1 / ``weight``, where the controller's action replaces that of the data; Ross, Gordon and Bagnell
    (2011), DAgger, for the states.

    Args:
        base: the loss to add the term to.
        limit: the largest action.
        weight: weight of the distance at first; Fujimoto and Gu have 1 / α = 0.4.
        final_weight: weight after ``decay_steps``, reached geometrically; None: it stays.
        decay_steps: environment steps that the decay takes; after a cloning phase, they count from its end.

    Raises:
        UavrlError: for a decay from a weight of 0.
        KeyError: from ``actor_loss``, for a batch without the controller's actions.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from uavrl.losses import DDPGLoss
        >>> from uavrl.models import Actor, Critic
        >>> critic = Mod(Critic(6, 2), ["observation", "action"], ["state_action_value"])
        >>> loss = Imitation(DDPGLoss(Mod(Actor(6, 2), ["observation"], ["action"]), critic), limit=2.0)
        >>> batch = TensorDict({"observation": torch.zeros(5, 6), "demonstrator_action": torch.ones(5, 2)}, [5])
        >>> sorted(loss.actor_loss(batch)[1])
        ['demonstrator_distance', 'state_action_value_actor']
    """

    learns_from_single_steps = False
    relative = True
    computed: ClassVar[Mapping[str, str]] = {"weight": "first_weight, final_weight and decay_steps"}

    @dataclass
    class _AcceptedKeys(ActorPenalty._AcceptedKeys):
        """``demonstrator_action`` is the scripted controller's action in the state, ``action`` the actor's."""

        demonstrator_action: NestedKey = "demonstrator_action"
        action: NestedKey = "action"

    default_keys = _AcceptedKeys

    def __init__(
        self,
        base: LossModule,
        *,
        limit: Positive = 1.0,
        weight: NonNegative = 1.0,
        final_weight: Positive | None = None,
        decay_steps: Count = 60_000,
    ) -> None:
        if not weight and final_weight is not None:
            raise UavrlError(
                f"weight must be above 0 to decay to a final_weight, which is {final_weight}, got {weight}."
            )
        super().__init__(base)
        self.limit, self.first_weight, self.final_weight, self.decay_steps = limit, weight, final_weight, decay_steps
        self.weight: Tensor
        self.steps: Tensor
        self.register_buffer("weight", torch.tensor(float(weight)))
        self.register_buffer("steps", torch.tensor(0))

    @torch.no_grad()
    def observe(self, episodes: TensorDictBase) -> None:
        """Lets the weight decay by the steps of whole new episodes ``[T]``."""
        super().observe(episodes)
        self.steps += len(episodes)
        self._refresh()

    @torch.no_grad()
    def restart(self) -> None:
        """Lets the weight begin its decay now, at the end of a phase in which the term took no part."""
        self.steps.zero_()
        self._refresh()

    @torch.no_grad()
    def _refresh(self) -> None:
        """Computes the weight."""
        self.weight.fill_(decayed(self.first_weight, self.final_weight, self.steps.item() / self.decay_steps))

    def diagnostics(self) -> dict[str, float]:
        """The base's, and the weight of now."""
        return super().diagnostics() | {"imitation_weight": float(self.weight)}

    @property
    def in_keys(self) -> list[NestedKey]:
        """What :meth:`forward` reads."""
        return [*self._inner.in_keys, self.tensor_keys.demonstrator_action]

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's action, and the scripted controller's if the batch has it."""
        acted, scripted = super().act(tensordict), tensordict.get(self.tensor_keys.demonstrator_action, None)
        return acted if scripted is None else acted.set(self.tensor_keys.demonstrator_action, scripted)

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """``weight`` times the distance to the scripted controller, for each sample ``[*B]``."""
        key = self.tensor_keys.demonstrator_action
        scripted = acted.get(key, None)
        if scripted is None:
            raise KeyError(
                f"Imitation reads {key!r}, and the batch has only {sorted(map(str, acted.keys(True, True)))}: "
                "write it while episodes are collected, see uavrl.transforms.demonstrator.Demonstrator."
            )
        distance = action_distance(acted.get(self.tensor_keys.action), scripted, self.limit)
        return self.weight * distance, {"demonstrator_distance": distance.detach()}
