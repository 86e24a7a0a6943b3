"""What the networks of a run read and write."""

from dataclasses import dataclass

import torch
from torchrl.data import Bounded
from torchrl.envs import CatFrames, Compose, EnvBase, Transform

from uavrl.errors import UavrlError


@dataclass(frozen=True)
class NetworkSizes:
    """Widths of state and action.

    Attributes:
        state: numbers in the policy's state.
        frames: observations in a state.
        actions: numbers in an action.
        limit: the largest action; the smallest is its negative.
    """

    state: int
    frames: int
    actions: int
    limit: float

    def action_spec(self, device: torch.device | str) -> Bounded:
        """The bounds of one action."""
        return Bounded(-self.limit, self.limit, (self.actions,), device=device)


def network_sizes(env: EnvBase) -> NetworkSizes:
    """The sizes of an environment with its transforms."""
    spec = env.action_spec_unbatched
    limit = float(spec.high.max()) if isinstance(spec, Bounded) else 0.0
    if not isinstance(spec, Bounded) or not bool((spec.high == limit).all() and (spec.low == -limit).all()):
        raise UavrlError(f"Expected actions in [-a, a], got {spec}: scale them by a transform.")
    stacks = [t.N for t in inner_transforms(getattr(env, "transform", None)) if isinstance(t, CatFrames)]
    width = int(env.observation_spec["observation"].shape[-1])
    return NetworkSizes(width, stacks[-1] if stacks else 1, int(spec.shape[-1]), limit)


def inner_transforms(transform: Transform | None) -> list[Transform]:
    """The transforms of a composition, in their order."""
    if isinstance(transform, Compose):
        return [inner for outer in transform.transforms for inner in inner_transforms(outer)]
    return [] if transform is None else [transform]
