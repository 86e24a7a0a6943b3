"""The policy's observation: the reduction's cells, the altitude, the two goal angles, and the action that led to it."""

from collections.abc import Sequence
from typing import get_args

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs.transforms import ObservationTransform, Transform

from uavrl.entries import entry, entry_spec
from uavrl.shown import Shown
from uavrl_onboard.perception.observation import Angles
from uavrl_onboard.vehicle import VEHICLE

# Beside the cells stand, in this order: altitude, heading, elevation
BESIDE_SIGNS = (1.0, -1.0, 1.0)  # what a mirror that exchanges left and right multiplies each by
HEADING = -2  # the heading's place, counted from their end


def navigation_observation(
    faces: Tensor,
    altitude: Tensor,
    heading_deg: Tensor,
    elevation_deg: Tensor,
    *,
    radius: float = 4.0,
    flight_level: float = VEHICLE.flight_level,
    angles: Angles = "folded",
) -> Tensor:
    """Chansuparp (2022), §3.2: o = (f_1 … f_32, z, h, g), scaled for a network.

    The faces are divided by the ball's radius and the altitude becomes z / p_approAlt - 1. The angles are folded to
    [-1, 1] with 0 = facing the goal, because the thesis's 0 to 360 degrees jump exactly there. For comparison
    ``angles="raw"`` keeps the degrees, and ``"turns"`` divides them by 360: they still jump, but are small.

    Args:
        faces: ``[*B, 32]``, m; or another reduction's ``[*B, cells]``.
        altitude: ``[*B, 1]``, m.
        heading_deg: ``[*B, 1]``, degrees in [0, 360).
        elevation_deg: as well.
        radius: the ball's radius, m.
        flight_level: p_approAlt, m.
        angles: ``"folded"``, ``"turns"`` or ``"raw"``.

    Returns:
        ``[*B, 35]``, or as many numbers as cells and three.

    Examples:
        >>> o = navigation_observation(
        ...     torch.full((32,), 2.0), torch.tensor([7.0]), torch.tensor([270.0]), torch.tensor([45.0]))
        >>> o[-4:].tolist()
        [0.5, 1.0, -0.5, 0.25]
    """
    if angles == "folded":
        heading_deg, elevation_deg = ((a + 180).remainder(360) / 180 - 1 for a in (heading_deg, elevation_deg))
    elif angles == "turns":
        heading_deg, elevation_deg = heading_deg / 360, elevation_deg / 360
    return torch.cat([faces / radius, altitude / flight_level - 1, heading_deg, elevation_deg], -1)


class NavigationObservation(Shown, ObservationTransform):
    """Writes the policy's observation of one frame.

    Args:
        radius, flight_level, angles: as in :func:`navigation_observation`.
        in_keys: keys of the faces, the altitude, the heading and the elevation.
        out_keys: where the observation goes.

    Raises:
        ValueError: for an unknown ``angles`` or another number of keys than four and one.

    Examples:
        >>> from tensordict import TensorDict
        >>> data = TensorDict({"faces": torch.zeros(2, 32), "altitude": torch.full((2, 1), 3.5),
        ...                    "heading_deg": torch.zeros(2, 1), "elevation_deg": torch.zeros(2, 1)}, [2])
        >>> NavigationObservation()(data)["observation"].shape
        torch.Size([2, 35])
    """

    def __init__(
        self,
        radius: float = 4.0,
        flight_level: float = VEHICLE.flight_level,
        angles: Angles = "folded",
        *,
        in_keys: Sequence[NestedKey] = ("faces", "altitude", "heading_deg", "elevation_deg"),
        out_keys: Sequence[NestedKey] = ("observation",),
    ) -> None:
        if angles not in get_args(Angles):
            raise ValueError(f"angles must be one of {', '.join(get_args(Angles))}, got {angles!r}.")
        if len(in_keys) != 4 or len(out_keys) != 1:
            raise ValueError(
                f"NavigationObservation takes four in_keys (faces, altitude, heading, elevation) and one out_key, "
                f"got {list(in_keys)} and {list(out_keys)}."
            )
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self.radius = radius
        self.flight_level = flight_level
        self.angles: Angles = angles

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        values = [entry(next_tensordict, key, self) for key in self.in_keys]
        observation = navigation_observation(
            *values, radius=self.radius, flight_level=self.flight_level, angles=self.angles
        )
        return next_tensordict.set(self.out_keys[0], observation)

    forward = _call

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the observation's spec: one float per face, altitude and angle."""
        assert isinstance(observation_spec, Composite)
        specs = [entry_spec(observation_spec, key, self) for key in self.in_keys]
        shape = (*specs[0].shape[:-1], sum(spec.shape[-1] for spec in specs))
        observation_spec[self.out_keys[0]] = Unbounded(shape, specs[0].device, specs[0].dtype)
        return observation_spec


class LastAction(Shown, Transform):
    """Writes beside an observation which action led to it, zeros after a reset.

    A vehicle's last command says how it moves now. Join it to the observation by TorchRL's ``CatTensors``.

    Args:
        limits: what the vehicle takes of each component at most; None: what was asked for.
        in_keys: key of the action.
        out_keys: where the last one goes.

    Raises:
        ValueError: for another number of keys than one and one.

    Examples:
        >>> from torchrl.envs import GymEnv, TransformedEnv
        >>> env = TransformedEnv(GymEnv("Pendulum-v1"), LastAction())
        >>> env.rollout(3, lambda tensordict: tensordict.set("action", torch.ones(1)))["last_action"].flatten().tolist()
        [0.0, 1.0, 1.0]
    """

    def __init__(
        self,
        *,
        limits: Sequence[float] | None = None,
        in_keys: Sequence[NestedKey] = ("action",),
        out_keys: Sequence[NestedKey] = ("last_action",),
    ) -> None:
        if len(in_keys) != 1 or len(out_keys) != 1:
            raise ValueError(f"LastAction takes one in_key and one out_key, got {list(in_keys)} and {list(out_keys)}.")
        super().__init__(in_keys=list(in_keys), out_keys=list(out_keys))
        self.limits = None if limits is None else tuple(limits)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Stored transitions with the action beside the next observation."""
        self._step(tensordict, entry(tensordict, "next", self))
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        action = entry(tensordict, self.in_keys[0], self)
        if self.limits is not None:
            most = action.new_tensor(self.limits)
            action = torch.minimum(torch.maximum(action, -most), most)
        return next_tensordict.set(self.out_keys[0], action)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.set(self.out_keys[0], self._action_spec().zero())

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the last action, of the action's spec."""
        assert isinstance(observation_spec, Composite)
        observation_spec[self.out_keys[0]] = self._action_spec().clone()
        return observation_spec

    def _action_spec(self) -> TensorSpec:
        assert self.parent is not None, "only an environment's transform is reset"
        return entry_spec(self.parent.full_action_spec, self.in_keys[0], self)
