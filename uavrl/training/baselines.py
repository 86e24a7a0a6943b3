"""Policies that learn nothing: yardsticks for a task's difficulty."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from uavrl.envs.navigation import ACTION_LIMIT


class StraightPolicy:
    """Turns to the goal and flies straight at it, blind to obstacles.

    It turns on the spot until the goal lies within ``cone`` of the head, then flies at full speed,
    and holds the flight level. How often it arrives tells how cluttered a valley is.

    Args:
        flight_level: altitude to hold, m.
        cone: half-angle within which it flies, rad.

    Examples:
        >>> from tensordict import TensorDict
        >>> state = TensorDict({"heading_deg": torch.tensor([[0.0], [90.0]]), "altitude": torch.full((2, 1), 3.5)}, [2])
        >>> StraightPolicy()(state)["action"].tolist()
        [[2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0]]
    """

    def __init__(self, flight_level: float = 3.5, cone: float = 0.15) -> None:
        self.flight_level = flight_level
        self.cone = cone

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` from ``heading_deg`` and ``altitude``."""
        heading = torch.deg2rad((tensordict["heading_deg"] + 180).remainder(360) - 180)
        forward = ACTION_LIMIT * (heading.abs() < self.cone).float()
        climb = (self.flight_level - tensordict["altitude"]).clamp(-ACTION_LIMIT, ACTION_LIMIT)
        turn = (3 * heading).clamp(-ACTION_LIMIT, ACTION_LIMIT)
        return tensordict.set("action", torch.cat([forward, torch.zeros_like(forward), climb, turn], -1))
