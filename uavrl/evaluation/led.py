"""A policy that reads the goal's direction itself, led along the way through a map of its episode."""

from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from uavrl.transforms.waypoint import heading_to_waypoint


class Led(TensorDictModuleBase):
    """Shows a policy the heading to the :class:`~uavrl.transforms.Waypoint` as that to the goal.

    Args:
        policy: reads ``heading_deg`` and writes ``action``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> turns = TensorDictModule(lambda heading: heading / 90, ["heading_deg"], ["action"])
        >>> seen = TensorDict(heading_deg=torch.zeros(1, 1), waypoint_deg=torch.full((1, 1), 45.0), batch_size=[1])
        >>> Led(turns)(seen)["action"], seen["heading_deg"]
        (tensor([[0.5000]]), tensor([[0.]]))
    """

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy: Any = policy
        self.in_keys = [*policy.in_keys, "waypoint_deg"]
        self.out_keys = list(getattr(policy, "out_keys", ["action"]))
        if hasattr(policy, "flown"):
            self.flown = policy.flown

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``; the goal's own heading stays."""
        return tensordict.set("action", self.policy(heading_to_waypoint(tensordict.copy()))["action"])
