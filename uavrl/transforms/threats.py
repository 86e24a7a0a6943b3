"""Where a vehicle would meet moving objects, direction by direction, if they fly straight on."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from uavrl.ranges import Positive
from uavrl.transforms.motion import OBJECT
from uavrl.transforms.range_image import grid_directions

__all__ = ["DIRECTIONS", "Threats", "greatest_threats", "predict_path", "straight_on", "threat", "to_yaw"]

STEPS, PERIOD = 20, 0.1  # that are looked ahead, in s each: two seconds
TIMES = torch.arange(1, STEPS + 1) * PERIOD
LAG = 0.4  # s, until a commanded velocity is nearly flown
WIDE = 1.45  # m: 0.6 of wing, 0.35 of hull, 0.5 between
HIGH = 0.6  # m: 0.27 of fin, 0.14 of hull, 0.19 between
GREATEST = 2.2  # of threats
DIRECTIONS = grid_directions(24, (-0.5, 0.0, 0.5))
"""In which a vehicle may fly, ``[72, 3]``: forward, left, up."""


def predict_path(commanded: Tensor, velocity: Tensor) -> Tensor:
    """Where a vehicle will be ``[*B, T, 3]`` from here: its velocity follows the commanded one with a first-order lag.

    Args:
        commanded: velocities ``[*B, 3]`` in m/s.
        velocity: what it has now, likewise.

    Examples:
        >>> predict_path(torch.tensor([2.0, 0.0, 0.0]), torch.tensor([2.0, 0.0, 0.0]))[-1].tolist()
        [4.0, 0.0, 0.0]
    """
    times = TIMES.to(commanded)
    lost = LAG * (1 - torch.exp(-times / LAG))
    return commanded[..., None, :] * (times - lost)[:, None] + velocity[..., None, :] * lost[:, None]


def threat(gap: Tensor) -> Tensor:
    """How near one comes to a body and how soon ``[*B]``, of what lies between ``[*B, T, 3]``; 0 is far.

    Examples:
        >>> threat(torch.full((STEPS, 3), 9.0)).item()
        0.0
    """
    apart = torch.maximum(gap[..., :2].norm(dim=-1) / WIDE, gap[..., 2].abs() / HIGH)  # below 1: too near
    share = TIMES.to(gap) / TIMES[-1]
    soon = (1.2 - 0.2 * share - apart).clamp_min(0) * (1 - 0.5 * share)
    return soon.amax(-1) + (apart < 1).any(-1).to(gap)


def straight_on(objects: Tensor) -> tuple[Tensor, Tensor]:
    """The ways ``[N, K, T, 3]`` of moving objects ``[N, K * 7]``, and which of them there are, ``bool [N, K]``.

    The objects are :class:`uavrl.transforms.MovingObjects`.
    """
    each = objects.unflatten(-1, (-1, len(OBJECT)))
    ways = each[..., None, :3] + each[..., None, 3:6] * TIMES.to(each)[:, None]
    return ways, each[..., -1] > 0


def to_yaw(vectors: Tensor, yaw: Tensor) -> Tensor:
    """Turns vectors ``[N, ..., 3]`` from world axes into those of yaws ``[N]`` in rad.

    Examples:
        >>> to_yaw(torch.tensor([[0.0, 2.0, 1.0]]), torch.tensor([torch.pi / 2])).round(decimals=3).tolist()
        [[2.0, -0.0, 1.0]]
    """
    yaw = yaw.reshape(-1, *[1] * (vectors.ndim - 2))
    x, y, z = vectors.unbind(-1)
    return torch.stack([yaw.cos() * x + yaw.sin() * y, yaw.cos() * y - yaw.sin() * x, z], -1)


def greatest_threats(commanded: Tensor, velocity: Tensor, ways: Tensor, known: Tensor) -> Tensor:
    """The greatest threat of any body on each commanded velocity, ``[N, *D]``.

    Args:
        commanded: ``[N, *D, 3]`` in m/s, in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
    """
    worst = commanded.new_zeros(commanded.shape[:-1])
    spread = [1] * (commanded.ndim - 2)
    for body in range(known.shape[-1]):
        which = known[:, body].nonzero()[:, 0]
        if len(which):
            path = predict_path(commanded[which], velocity[which].reshape(-1, *spread, 3))
            gap = path - ways[which, body].reshape(-1, *spread, *ways.shape[2:])
            worst[which] = torch.maximum(worst[which], threat(gap))
    return worst


class Threats(Transform):
    """Writes how near moving objects would come on the way in each of 72 directions, and standing.

    For each direction at full speed, and for standing, :func:`threat` of the object that comes nearest within two
    seconds, over the greatest: 0 where none comes near, above 0.45 where one is met. The objects fly straight on. They
    are met within 1.45 m level and 0.6 m in height, which suits planes of 1.2 m.

    Args:
        speed: at which the directions are flown, m/s.
        in_keys: moving objects ``[*B, K * 7]`` as :class:`uavrl.transforms.MovingObjects` writes them, velocities
            ``[*B, 3]`` (m/s, world axes) and attitudes ``[*B, 3]`` (roll, pitch and yaw in rad).
        out_keys: where the threats go, ``[*B, 73]``: of the directions in the order of ``DIRECTIONS``, and of standing.

    Raises:
        ValueError: for another number of keys than three and one.

    Examples:
        Something comes head-on, 5 m ahead:

        >>> from tensordict import TensorDict
        >>> coming = torch.tensor([[5.0, 0.0, 0.0, -3.0, 0.0, 0.0, 1.0]])
        >>> state = TensorDict(moving_objects=coming, velocity=torch.zeros(1, 3), attitude=torch.zeros(1, 3))
        >>> threats = Threats()(state)["threats"][0]
        >>> ahead, behind, left, standing = (threats[place].item() for place in (1, 37, 19, 72))
        >>> ahead > 0.45, behind, left, standing > 0.45
        (True, 0.0, 0.0, True)
    """

    invertible = False

    def __init__(
        self,
        speed: Positive = 2.0,
        *,
        in_keys: Sequence[NestedKey] = ("moving_objects", "velocity", "attitude"),
        out_keys: Sequence[NestedKey] = ("threats",),
    ) -> None:
        if len(in_keys) != 3 or len(out_keys) != 1:
            raise ValueError(
                f"Threats takes three in_keys (objects, velocity, attitude) and one out_key, got {list(in_keys)} and "
                f"{list(out_keys)}."
            )
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self.register_buffer("commanded", torch.cat([speed * DIRECTIONS, torch.zeros(1, 3)]))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds the threats."""
        return self._call(tensordict)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        told = [next_tensordict.get(key) for key in self.in_keys]
        batch = told[0].shape[:-1]
        objects, velocity, attitude = (value.reshape(batch.numel(), value.shape[-1]) for value in told)
        found = objects.new_zeros(len(objects), len(self.commanded))
        some = (objects != 0).any(-1).nonzero()[:, 0]
        if len(some):
            commanded = self.commanded.to(objects).expand(len(some), -1, -1)
            own = to_yaw(velocity[some], attitude[some, 2]).to(objects)
            found[some] = greatest_threats(commanded, own, *straight_on(objects[some])) / GREATEST
        return next_tensordict.set(self.out_keys[0], found.reshape(*batch, len(self.commanded)))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the spec of the threats."""
        assert isinstance(observation_spec, Composite)
        objects = observation_spec[self.in_keys[0]]
        shape = (*objects.shape[:-1], len(self.commanded))
        observation_spec[self.out_keys[0]] = Unbounded(shape, objects.device, objects.dtype)
        return observation_spec
