"""Staying near what a guide would do, while learning from rewards."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.enhancer import Enhancer
from uavrl.ranges import NonNegative, Positive


def distance_to_guide(action: Tensor, guide_action: Tensor, limit: float) -> Tensor:
    """Mean squared difference ``[*B]`` of actions ``[*B, A]``, in units of the largest action.

    Examples:
        >>> import torch
        >>> distance_to_guide(torch.tensor([2.0, 0.0]), torch.tensor([0.0, 0.0]), 2.0).item()
        0.5
    """
    return ((action - guide_action) / limit).square().mean(-1)


class Imitation(Enhancer):
    """What the actor does beside what a guide would have done in the same state costs.

    The cost is ``weight · mean |objective| · ‖(μ(s) - g(s)) / limit‖² / A``, so that it keeps its share while values
    grow. The guide's action is known in states that the policy has reached by itself, too, not only in the guide's
    own flights.

    Source: Fujimoto and Gu (2021), A Minimalist Approach to Offline Reinforcement Learning (arXiv:2106.06860), Eq. 3
    and 5 with α = 1 / ``weight``, where the guide's action stands for that of the data; Ross, Gordon and Bagnell
    (2011), DAgger, for the states.

    Args:
        base: the loss to enhance.
        limit: the largest action.
        weight: of the distance; Fujimoto and Gu have 1 / α = 0.4.

    Raises:
        KeyError: from ``actor_loss``, for a batch without the guide's actions.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from torchrl.data import Bounded
        >>> from uavrl.losses import Imitation, TD3Loss
        >>> from uavrl.models import Actor, Critic
        >>> critics = [
        ...     TensorDictModule(Critic(6, 2), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
        >>> actor = TensorDictModule(Actor(6, 2), ["observation"], ["action"])
        >>> loss = Imitation(TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (2,))), limit=2.0)
        >>> told = TensorDict({"observation": torch.zeros(5, 6), "guide_action": torch.ones(5, 2)}, [5])
        >>> sorted(loss.actor_loss(told)[1])
        ['guide_distance', 'state_action_value_actor']
    """

    learns_from_single_steps = False

    @dataclass
    class _AcceptedKeys(Enhancer._AcceptedKeys):
        """``guide_action`` is what the guide would do in the state, ``action`` what the actor writes."""

        guide_action: NestedKey = "guide_action"
        action: NestedKey = "action"

    default_keys = _AcceptedKeys

    def __init__(self, base: ActorCriticLoss, *, limit: Positive = 1.0, weight: NonNegative = 1.0) -> None:
        super().__init__(base)
        self.limit, self.weight = limit, weight

    @property
    def in_keys(self) -> list[NestedKey]:
        """What :meth:`forward` reads."""
        return [*self.base.in_keys, self.tensor_keys.guide_action]

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's action, and beside it the guide's, where it is known."""
        acted, told = self.base.act(tensordict), tensordict.get(self.tensor_keys.guide_action, None)
        return acted if told is None else acted.set(self.tensor_keys.guide_action, told)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's objective and, in its size, the term."""
        objective, metadata = self.base.actor_objective(acted, target=target)
        term, own = self.actor_term(acted)
        return objective + objective.detach().abs().mean() * term, metadata | own

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """``weight`` times the distance to the guide, of each sample ``[*B]``."""
        key = self.tensor_keys.guide_action
        told = acted.get(key, None)
        if told is None:
            raise KeyError(
                f"Imitation reads {key!r}, and the batch has only {sorted(map(str, acted.keys(True, True)))}: "
                "write it where the states are flown, see uavrl.transforms.guidance.Guidance."
            )
        distance = distance_to_guide(acted.get(self.tensor_keys.action), told, self.limit)
        return self.weight * distance, {"guide_distance": distance.detach()}
