"""An actor that changes its action little from step to step."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import LossModule

from uavrl.losses.actor_penalty import ActorPenalty
from uavrl.losses.imitation import action_distance
from uavrl_onboard.ranges import Count, NonNegative, Positive


class ActionRate(ActorPenalty):
    """Adds the distance between the actor's action and the one before it to the actor's objective.

    The term is ``weight · mean |objective| · ‖(μ(s_t) - a_{t-1}) / limit‖² / A``, so that its share stays while values
    grow; around an imitation the objective holds that, too. The action before is the end of the state, where
    ``perception.last_action=true`` puts it, over the limit.

    Source: the temporal term of Mysore et al. (2021), Regularizing Action Policies for Smooth Control with
    Reinforcement Learning (arXiv:2012.06644), with the action that was taken before, in place of the policy's in the
    next state, which n-step returns leave out.

    Args:
        base: the loss to add the term to.
        actions: numbers in an action.
        limit: the largest action.
        weight: weight of the distance.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from uavrl.losses import DDPGLoss
        >>> from uavrl.models import Actor, Critic
        >>> critic = Mod(Critic(6, 2), ["observation", "action"], ["state_action_value"])
        >>> loss = ActionRate(DDPGLoss(Mod(Actor(6, 2), ["observation"], ["action"]), critic), actions=2, limit=2.0)
        >>> sorted(loss.actor_loss(TensorDict({"observation": torch.zeros(5, 6)}, [5]))[1])
        ['action_rate', 'state_action_value_actor']
    """

    learns_from_single_steps = False
    relative = True
    reads_last_action = True

    @dataclass
    class _AcceptedKeys(ActorPenalty._AcceptedKeys):
        """``observation`` is the state, which ends with the last action; ``action`` is the actor's."""

        observation: NestedKey = "observation"
        action: NestedKey = "action"

    default_keys = _AcceptedKeys

    def __init__(self, base: LossModule, *, actions: Count, limit: Positive = 1.0, weight: NonNegative = 0.2) -> None:
        super().__init__(base)
        self.actions, self.limit, self.weight = actions, limit, weight

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """``weight`` times the distance to the last action, for each sample ``[*B]``."""
        keys = self.tensor_keys
        last = self.limit * acted.get(keys.observation)[..., -self.actions :]
        distance = action_distance(acted.get(keys.action), last, self.limit)
        return self.weight * distance, {"action_rate": distance.detach()}
