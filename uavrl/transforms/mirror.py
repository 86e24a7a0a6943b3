"""Transitions as they would look in a mirror at the vehicle's side."""

from collections.abc import Sequence
from functools import lru_cache

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from uavrl.transforms.functional import NUM_FACES, truncated_icosahedron_faces

__all__ = ["Mirror", "mirror_action", "mirror_observation"]

ACTION_SIGNS = (1.0, -1.0, 1.0, -1.0)  # forward, left, up, yaw rate
ALONE = NUM_FACES + 3  # numbers in an observation
WITH_ACTION = ALONE + len(ACTION_SIGNS)  # and in one that ends with the last action


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def _places_and_signs(device: torch.device) -> tuple[Tensor, Tensor]:
    """Where each of an observation's numbers comes from in the mirrored one, and its sign; the last 4 are an action."""
    normals = truncated_icosahedron_faces(dtype=torch.float64).normals
    image = ((normals * normals.new_tensor([1.0, -1.0, 1.0])) @ normals.T).argmax(-1)
    places = torch.cat([image, torch.arange(NUM_FACES, WITH_ACTION)])
    signs = torch.cat([torch.ones(ALONE), torch.tensor(ACTION_SIGNS)])
    signs[NUM_FACES + 1] = -1.0  # the heading
    return places.to(device), signs.to(device)


def mirror_observation(observation: Tensor, *, last_action: bool = False) -> Tensor:
    """What a vehicle sees in the mirror image of its world, left and right exchanged (y → -y).

    The 32 faces change places, altitude and elevation stay, the heading changes its sign (Chansuparp (2022), §3.2, has
    the observation; for symmetric transitions in replay see Lin et al. (2020), arXiv:1911.02437).

    Args:
        observation: ``[*B, F * 35]`` (39 with ``last_action``), F stacked ones of
            :func:`uavrl.transforms.navigation_observation` with folded angles.
        last_action: whether each observation ends with an action, as :class:`uavrl.transforms.LastAction` makes it.

    Raises:
        ValueError: for another width.

    Examples:
        >>> seen = torch.zeros(35)
        >>> seen[0], seen[33] = 0.5, 0.25  # a point behind pentagon 0, below at the left, and the goal at the left
        >>> mirrored = mirror_observation(seen)
        >>> mirrored.nonzero().flatten().tolist(), mirrored[33].item()
        ([1, 33], -0.25)
    """
    places, signs = (each[: WITH_ACTION if last_action else ALONE] for each in _places_and_signs(observation.device))
    if not observation.shape[-1] or observation.shape[-1] % len(places):
        raise ValueError(f"Expected observations [*B, F * {len(places)}], got {list(observation.shape)}.")
    frames = observation.unflatten(-1, (-1, len(places)))
    return (frames.index_select(-1, places) * signs.to(frames.dtype)).flatten(-2)


def mirror_action(action: Tensor) -> Tensor:
    """The action that does in the mirror image of the world what ``action [*B, 4]`` does in the world.

    Examples:
        >>> mirror_action(torch.tensor([1.0, 0.5, -1.0, 2.0])).tolist()
        [1.0, -0.5, -1.0, -2.0]
    """
    return action * action.new_tensor(ACTION_SIGNS)


class Mirror(Transform):
    """Shows each transition that a replay buffer samples as its mirror image, half of the time.

    The sensor and the rewards know no difference between left and right, so the image is a transition that could have
    been flown. The rotors do know one, as they turn the same way in both: flights and their images agree to
    millimetres, but where commands take the rotors to their limits. Random numbers come from PyTorch's generator.

    Args:
        in_keys: the observations, ``[B, F * 35]``, with folded angles.
        action: key of the actions, ``[B, 4]``.
        probability: of the image.
        last_action: as in :func:`mirror_observation`.

    Raises:
        ValueError: for a probability outside [0, 1].

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
        action: NestedKey = "action",
        probability: float = 0.5,
        last_action: bool = False,
    ) -> None:
        if not 0.0 <= probability <= 1.0:
            raise ValueError(f"probability must be in [0, 1], got {probability}.")
        super().__init__(in_keys=[*in_keys, action], out_keys=[*in_keys, action])
        self.probability = probability
        self.last_action = last_action

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The batch ``[B]`` with some of its transitions mirrored; what was stored stays as it is."""
        tensordict = tensordict.copy()  # a slice of a storage is the storage
        *observations, action = self.in_keys
        device = tensordict.get(action).device
        mirrored = (torch.rand(tensordict.batch_size, device=device) < self.probability).unsqueeze(-1)
        for key in observations:
            value = tensordict.get(key)
            tensordict.set(key, torch.where(mirrored, mirror_observation(value, last_action=self.last_action), value))
        value = tensordict.get(action)
        return tensordict.set(action, torch.where(mirrored, mirror_action(value), value))
