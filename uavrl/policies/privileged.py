"""Demonstrators that head along a way that the environment emits, instead of towards the goal."""

from dataclasses import replace
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from uavrl.envs.limits import OrMapping
from uavrl.envs.privileged import as_moving_objects
from uavrl.envs.quadrotor import Airframe
from uavrl.policies.baselines import VectorFieldHistogram, VFHWeights
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl.transforms.reduction import Statistic
from uavrl_onboard.perception.cells import RangeGrid
from uavrl_onboard.perception.motion.threats import straight_on
from uavrl_onboard.perception.reductions import Reduction
from uavrl_onboard.vehicle import VEHICLE

CAUTION, HEADWAY = 0.6, 0.7  # of vfh_headway (conf/demonstrator), where cells tell distances


class MappedVFH(VectorFieldHistogram):
    """A vector field histogram that leaves dead ends, along a way through what the LiDAR has shown in the episode.

    Elsewhere it heads for the goal. It is a teacher for policies with a memory: it knows nothing that its own episode
    has not shown.

    The environment emits what it reads (``mapped_way`` of :data:`uavrl.envs.privileged.QUANTITIES`).

    Its arguments are those of :class:`VectorFieldHistogram`. Where cells tell distances, its default costs have a
    headway.

    Examples:
        A dead end lies before the goal, and the way out leads to the left:

        >>> from tensordict import TensorDict
        >>> way, altitude = torch.tensor([[0.0, 1.0]]), torch.full((1, 1), 3.5)
        >>> state = {"faces": torch.zeros(1, 32), "altitude": altitude, "mapped_way": way}
        >>> forward, left, up, turn = MappedVFH()(TensorDict(state, [1]))["action"][0].tolist()
        >>> left > 1.9, turn > 0.8
        (True, True)
    """

    heading_key: ClassVar[str] = "mapped_way"

    @staticmethod
    def default_costs(reduction: Reduction, statistic: Statistic) -> VFHWeights | None:
        """Return those of its base, with a headway where cells tell distances."""
        costs = VectorFieldHistogram.default_costs(reduction, statistic)
        if costs is None or statistic != "proximity":
            return costs
        return replace(costs, caution=CAUTION, headway=HEADWAY)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` as its base does, with the direction of the way as the heading."""
        led = tensordict.copy().set("heading_deg", self.heading_deg(tensordict))
        return tensordict.set("action", super().forward(led)["action"])

    def heading_deg(self, tensordict: TensorDictBase) -> Tensor:
        """Return where it heads, ``[..., 1]`` degrees."""
        ahead, left = tensordict[self.heading_key].unbind(-1)
        return torch.rad2deg(torch.atan2(left, ahead))[..., None]


class TrapMappedVFH(MappedVFH):
    """A vector field histogram that leaves dead ends in valleys that were built with them. Elsewhere it has no map.

    In valleys with dead ends it is :class:`MappedVFH`, and in all other worlds :class:`VectorFieldHistogram`. Only the
    simulator knows which is which. A policy that clones it learns to leave dead ends, and less often takes long detours
    where there are none.

    The environment emits what it reads (``mapped_way`` and ``traps`` of :data:`uavrl.envs.privileged.QUANTITIES`).

    Its arguments are those of :class:`MappedVFH`.

    Examples:
        The way leads to the left, which counts only where there are dead ends:

        >>> from tensordict import TensorDict
        >>> way, altitude = torch.tensor([[0.0, 1.0]]).expand(2, 2), torch.full((2, 1), 3.5)
        >>> state = {"faces": torch.zeros(2, 32), "altitude": altitude, "heading_deg": torch.zeros(2, 1)}
        >>> state |= {"mapped_way": way, "traps": torch.tensor([[3.0], [0.0]])}
        >>> TrapMappedVFH()(TensorDict(state, [2]))["action"][:, 1].gt(1.9).tolist()
        [True, False]
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.in_keys += ["heading_deg", "traps"]

    def heading_deg(self, tensordict: TensorDictBase) -> Tensor:
        """Return the direction of the way, and where there are no dead ends that of the goal."""
        return torch.where(tensordict["traps"] > 0, super().heading_deg(tensordict), tensordict["heading_deg"])


class PrivilegedVFH(MappedVFH):
    """A vector field histogram that heads along the shortest path to the goal on the true map.

    It therefore leaves dead ends. With ``planes`` it also avoids the planes by their true positions, and assumes that
    they fly straight on. It is a teacher for policies without the map, after Loquercio et al. (2021), Learning
    high-speed flight in the wild (Science Robotics 6), whose teacher plans on the true map.

    The environment emits what it reads (``way`` and ``planes`` of :data:`uavrl.envs.privileged.QUANTITIES`).

    Args:
        flight_level: altitude to hold where nothing is in the way, within 1 m, m.
        radius: of the reduction in m.
        reduction: which cells it sees, as in :class:`uavrl.transforms.NavigationState`.
        statistic: value of a cell, likewise; None for the reduction's default.
        costs: None for those of :class:`VectorFieldHistogram`, and a headway where cells tell distances.
        last_action: whether the observation ends with the last action, likewise.
        planes: whether it avoids planes by their true positions.
        max_speed: limit of each component of the velocity, m/s.
        grid: where the cells of a range image are, likewise.
        airframe: whose hull it assumes; None for the default one.

    Examples:
        A dead end lies before the goal, and the way leads to the left:

        >>> from tensordict import TensorDict
        >>> way, altitude = torch.tensor([[0.0, 1.0]]), torch.full((1, 1), 3.5)
        >>> state = {"faces": torch.zeros(1, 32), "altitude": altitude, "way": way}
        >>> forward, left, up, turn = PrivilegedVFH(planes=False)(TensorDict(state, [1]))["action"][0].tolist()
        >>> left > 1.9, turn > 0.8
        (True, True)
    """

    heading_key = "way"

    def __init__(
        self,
        flight_level: float = VEHICLE.flight_level,
        radius: float = 4.0,
        reduction: Reduction = "truncated_icosahedron",
        statistic: Statistic | None = None,
        costs: VFHWeights | None = None,
        last_action: bool = False,
        planes: bool = True,
        grid: RangeGrid | None = None,
        max_speed: float = VEHICLE.velocity_limit,
        airframe: OrMapping[Airframe] | None = None,
    ) -> None:
        super().__init__(
            flight_level, radius, reduction, statistic, costs, last_action, None, grid, max_speed, airframe
        )
        self.in_keys += ["planes", "velocity", "attitude"] if planes else []
        self.evades = planes

    def ways(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Where planes will be if they fly straight on, and which there are."""
        ways, known = call_numpy(straight_on, call_numpy(as_moving_objects, tensordict["planes"]))
        return ways, known
