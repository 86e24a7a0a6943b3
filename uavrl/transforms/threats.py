"""The threats of moving objects (:mod:`uavrl_onboard.perception.motion.threats`) as a transform of TorchRL."""

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from uavrl.entries import entry, entry_spec
from uavrl.shown import Shown
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import world_to_yaw
from uavrl_onboard.perception.motion import threats
from uavrl_onboard.perception.motion.threats import GREATEST, greatest_threats, straight_on
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE

__all__ = ["DIRECTIONS", "Threats"]

DIRECTIONS = torch.from_numpy(threats.DIRECTIONS)
"""In which a vehicle may fly, ``[72, 3]``: forward, left, up."""


class Threats(Shown, Transform):
    """Writes how near moving objects would come on the way in each of 72 directions, and standing.

    For each direction at full speed, and for standing, the threat
    (:func:`uavrl_onboard.perception.motion.threats.threat`) of the object
    that comes nearest within two seconds, over the greatest: 0 where none comes near, above 0.45 where one is met. The
    objects fly straight on. They are met within 1.45 m level and 0.6 m in height, which suits planes of 1.2 m.

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
        speed: Positive = VEHICLE.velocity_limit,
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
        self.speed = speed
        self.register_buffer("commanded", torch.cat([speed * DIRECTIONS, DIRECTIONS.new_zeros(1, 3)]))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Adds the threats."""
        return self._call(tensordict)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        told = [entry(next_tensordict, key, self) for key in self.in_keys]
        batch = told[0].shape[:-1]
        objects, velocity, attitude = (value.reshape(batch.numel(), value.shape[-1]) for value in told)
        found = objects.new_zeros(len(objects), len(self.commanded))
        some = (objects != 0).any(-1).nonzero()[:, 0]
        if len(some):
            commanded = self.commanded.to(objects).expand(len(some), -1, -1)
            own = call_numpy(world_to_yaw, velocity[some], attitude[some, 2]).to(objects)
            ways, known = call_numpy(straight_on, objects[some])
            found[some] = call_numpy(greatest_threats, commanded, own, ways, known) / GREATEST
        return next_tensordict.set(self.out_keys[0], found.reshape(*batch, len(self.commanded)))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the spec of the threats."""
        assert isinstance(observation_spec, Composite)
        objects, *_ = (entry_spec(observation_spec, key, self) for key in self.in_keys)
        shape = (*objects.shape[:-1], len(self.commanded))
        observation_spec[self.out_keys[0]] = Unbounded(shape, objects.device, objects.dtype)
        return observation_spec
