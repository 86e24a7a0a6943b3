"""Transitions as they would look in a mirror at the vehicle's side."""

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from uavrl.entries import entry
from uavrl.shown import Shown
from uavrl.transforms.observation import BESIDE_SIGNS, HEADING
from uavrl.transforms.state import MOVING_OBJECTS, REDUCTIONS, cell_directions
from uavrl.transforms.threats import DIRECTIONS
from uavrl_onboard.perception.cells import RangeGrid
from uavrl_onboard.perception.reductions import Reduction

__all__ = ["Mirror", "mirror_action", "mirror_observation"]

OBJECT_SIGNS = (1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0)  # place, velocity and size of a moving object
STANDING_SIGN = (1.0,)  # of the threat to who stands
ACTION_SIGNS = (1.0, -1.0, 1.0, -1.0)  # forward, left, up, yaw rate


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def _places_and_signs(
    reduction: Reduction, grid: RangeGrid | None, last_action: bool, motion: bool, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Where each of an observation's numbers comes from in the mirrored one, and its sign."""
    kept: list[tuple[Tensor | None, tuple[float, ...]]]
    kept = [(_image(cell_directions(reduction, grid)), ()), (None, BESIDE_SIGNS)]
    if motion:
        kept += [(None, OBJECT_SIGNS * MOVING_OBJECTS), (_image(DIRECTIONS), ()), (None, STANDING_SIGN)]
    if last_action:
        kept += [(None, ACTION_SIGNS)]
    places, signs = torch.zeros(0, dtype=torch.long), torch.zeros(0)
    for image, part in kept:
        from_there = torch.arange(len(part)) if image is None else image
        places = torch.cat([places, len(places) + from_there])
        signs = torch.cat([signs, torch.tensor(part) if part else torch.ones(len(from_there))])
    return places.to(device), signs.to(device)


def _image(directions: Tensor) -> Tensor:
    """Which of ``directions [D, 3]`` is the mirror image of each."""
    return ((directions * directions.new_tensor([1.0, -1.0, 1.0])) @ directions.T).argmax(-1)


def mirror_observation(
    observation: Tensor,
    *,
    last_action: bool = False,
    motion: bool = False,
    reduction: Reduction = "truncated_icosahedron",
    grid: RangeGrid | None = None,
) -> Tensor:
    """What a vehicle sees in the mirror image of its world, left and right exchanged (y → -y).

    The reduction's cells change places, altitude and elevation stay, the heading changes its sign (Chansuparp (2022),
    §3.2, has the observation; for symmetric transitions in replay see Lin et al. (2020), arXiv:1911.02437).

    Args:
        observation: ``[*B, F * 35]`` (4 more each with ``last_action``, 94 with ``motion``), F stacked ones of
            :func:`uavrl.transforms.navigation_observation` with folded angles.
        last_action: whether each observation ends with an action, as :class:`uavrl.transforms.LastAction` makes it.
        motion: whether it also holds moving objects and their threats, as :class:`uavrl.transforms.NavigationState`
            puts them there.
        reduction: as in :class:`uavrl.transforms.NavigationState`.
        grid: as there.

    Raises:
        ValueError: for another width.

    Examples:
        >>> seen = torch.zeros(35)
        >>> seen[0], seen[33] = 0.5, 0.25  # a point behind pentagon 0, below at the left, and the goal at the left
        >>> mirrored = mirror_observation(seen)
        >>> mirrored.nonzero().flatten().tolist(), mirrored[33].item()
        ([1, 33], -0.25)
    """
    places, signs = _places_and_signs(reduction, grid, last_action, motion, observation.device)
    if not observation.shape[-1] or observation.shape[-1] % len(places):
        raise ValueError(f"Expected observations [*B, F * {len(places)}], got {list(observation.shape)}.")
    frames = observation.unflatten(-1, (-1, len(places)))
    image = frames.gather(-1, places.expand(frames.shape)) * signs.to(frames.dtype)  # index_select is slower there
    heading = image[..., len(cell_directions(reduction, grid)) + len(BESIDE_SIGNS) + HEADING]
    heading.masked_fill_(heading == 1.0, -1.0)  # straight behind is -1 on either side: folded angles are in [-1, 1)
    return image.flatten(-2)


def mirror_action(action: Tensor) -> Tensor:
    """The action that does in the mirror image of the world what ``action [*B, 4]`` does in the world.

    Examples:
        >>> mirror_action(torch.tensor([1.0, 0.5, -1.0, 2.0])).tolist()
        [1.0, -0.5, -1.0, -2.0]
    """
    return action * action.new_tensor(ACTION_SIGNS)


class Mirror(Shown, Transform):
    """Shows each transition or sequence that a replay buffer samples as its mirror image, half of the time.

    The sensor and the rewards treat left and right alike, so the image is a transition that could have been seen. The
    rotors turn the same way in both: an episode and its image agree to millimetres, except where commands take the
    rotors to their limits. Random numbers come from PyTorch's generator.

    Args:
        in_keys: the observations, ``[B, F * 35]``, with folded angles.
        actions: keys of the actions, ``[B, 4]``.
        probability: of the image.
        last_action, motion, reduction, grid: as in :func:`mirror_observation`.
        signed: keys of other entries, with the signs of their numbers in the image.

    Raises:
        ValueError: for a probability outside [0, 1], or an unknown reduction.

    Examples:
        >>> from tensordict import TensorDict
        >>> data = TensorDict({"observation": torch.zeros(2, 35), "action": torch.ones(2, 4),
        ...                    "next": {"observation": torch.zeros(2, 35)}}, [2])
        >>> Mirror(probability=1.0)(data)["action"].tolist()
        [[1.0, -1.0, 1.0, -1.0], [1.0, -1.0, 1.0, -1.0]]
    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey] = ("observation", ("next", "observation")),
        *,
        actions: Sequence[NestedKey] = ("action",),
        probability: float = 0.5,
        last_action: bool = False,
        motion: bool = False,
        reduction: Reduction = "truncated_icosahedron",
        grid: RangeGrid | None = None,
        signed: Mapping[NestedKey, Sequence[float]] | None = None,
    ) -> None:
        if not 0.0 <= probability <= 1.0:
            raise ValueError(f"probability must be in [0, 1], got {probability}.")
        if reduction not in REDUCTIONS:
            raise ValueError(f"reduction must be one of {', '.join(REDUCTIONS)}, got {reduction!r}.")
        super().__init__(in_keys=[*in_keys, *actions], out_keys=[*in_keys, *actions])
        self.signed = dict(signed or {})
        self.num_actions, self.probability = len(actions), probability
        self.last_action, self.motion, self.reduction, self.grid = last_action, motion, reduction, grid

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The batch ``[B]``, or ``[B, T]`` of sequences, with some mirrored; what was stored stays as it is."""
        tensordict = tensordict.copy()  # a slice of a storage is the storage
        observations, actions = self.in_keys[: -self.num_actions], self.in_keys[-self.num_actions :]
        device = entry(tensordict, actions[0], self).device
        drawn = torch.rand(tensordict.batch_size[:1], device=device) < self.probability
        mirrored = drawn.reshape(*drawn.shape, *[1] * tensordict.ndim)
        observed = partial(
            mirror_observation,
            last_action=self.last_action,
            motion=self.motion,
            reduction=self.reduction,
            grid=self.grid,
        )
        for keys, image in ((observations, observed), (actions, mirror_action)):
            for key in keys:
                value = entry(tensordict, key, self)
                tensordict.set(key, torch.where(mirrored, image(value), value))
        for key, signs in self.signed.items():
            value = entry(tensordict, key, self)
            tensordict.set(key, torch.where(mirrored, value * value.new_tensor(signs), value))
        return tensordict
