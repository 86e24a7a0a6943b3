"""The thesis's two reward functions, each a sum of named terms, as pure functions and as TorchRL transforms."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs.transforms import Transform, TransformedEnv

from uavrl.entries import entry
from uavrl.shown import Shown
from uavrl_onboard.ranges import Positive
from uavrl_onboard.vehicle import VEHICLE

RewardTerms = Callable[[TensorDictBase, TensorDictBase], dict[str, Tensor]]  # as :meth:`SumOfTerms.terms`
AltitudeTerm = Literal["absolute", "literal"]


def fold_degrees(angle_deg: Tensor) -> Tensor:
    """Folds an angle in degrees to its absolute size in [0, 180] (v_h and v_g of Eq. 3.6).

    Examples:
        >>> fold_degrees(torch.tensor([0.0, 90.0, 270.0, 359.0])).tolist()
        [0.0, 90.0, 90.0, 1.0]
    """
    angle_deg = angle_deg.remainder(360.0)
    return torch.minimum(angle_deg, 360.0 - angle_deg)


def total(terms: Mapping[str, Tensor]) -> Tensor:
    """The sum of terms, in their order."""
    return reduce(torch.add, terms.values())


def _with_ends(
    terms: dict[str, Tensor], arrived_t: Tensor, collided_t: Tensor, arrived_reward: float, collided_reward: float
) -> dict[str, Tensor]:
    """Adds what arriving and colliding give; where a step collides, nothing else counts."""
    nothing = torch.zeros_like(next(iter(terms.values())))
    terms = {**terms, "arrival": nothing.masked_fill(arrived_t, arrived_reward)}
    terms = {name: term.masked_fill(collided_t, 0.0) for name, term in terms.items()}
    return {**terms, "collision": nothing.masked_fill(collided_t, collided_reward)}


def traditional_terms(
    distance_tm1: Tensor,
    distance_t: Tensor,
    arrived_t: Tensor,
    collided_t: Tensor,
    *,
    arrived_reward: float = 50.0,
    collided_reward: float = -50.0,
) -> dict[str, Tensor]:
    """Chansuparp (2022), Eq. 2.15 with Table 4.1: a prize, a punishment, else the progress made.

    Args:
        distance_tm1: distance to the goal before the step, ``[*B]``, m.
        distance_t: the same after the step.
        arrived_t: bool ``[*B]``.
        collided_t: bool ``[*B]``; wins where both are true.
        arrived_reward: r_g.
        collided_reward: r_c.

    Returns:
        The terms whose sum is the reward, each ``[*B]``: progress, arrival, collision.

    Examples:
        >>> t = torch.tensor
        >>> terms = traditional_terms(t([5.0, 5.0]), t([4.5, 1.0]), t([False, True]), t([False, False]))
        >>> {name: term.tolist() for name, term in terms.items()}
        {'progress': [0.5, 0.0], 'arrival': [0.0, 50.0], 'collision': [0.0, 0.0]}
    """
    terms = {"progress": (distance_tm1 - distance_t).masked_fill(arrived_t, 0.0)}
    return _with_ends(terms, arrived_t, collided_t, arrived_reward, collided_reward)


def traditional_reward(*quantities: Tensor, **options: Any) -> Tensor:
    """The sum ``[*B]`` of :func:`traditional_terms`, which takes the same arguments.

    Examples:
        >>> t = torch.tensor
        >>> traditional_reward(t(5.0), t(4.5), t(False), t(False)).item()
        0.5
    """
    return total(traditional_terms(*quantities, **options))


def navigation_terms(
    distance_tm1: Tensor,
    distance_t: Tensor,
    altitude_t: Tensor,
    heading_deg_t: Tensor,
    elevation_deg_t: Tensor,
    arrived_t: Tensor,
    collided_t: Tensor,
    *,
    weights: Sequence[float] = (8.0, 1.0, 0.5, 0.5),
    flight_level: float = VEHICLE.flight_level,
    collided_reward: float = -50.0,
    arrived_reward: float = 0.0,
    altitude_term: AltitudeTerm = "absolute",
) -> dict[str, Tensor]:
    """Chansuparp (2022), Eq. 3.6: progress, flight level and two angles to the goal.

    A UAV that hovers in front of its goal, facing it, earns up to w_2 + w_3 + w_4 a step for ever, and nothing
    once it has arrived: with discount γ, Eq. 3.6 alone pays loitering up to (w_2 + w_3 + w_4) / (1 - γ). An
    ``arrived_reward`` of that size (200 with the thesis's numbers) takes the advantage away; the thesis has none.

    The thesis prints the altitude term without an absolute value, which pays the UAV twice for lying
    on the ground; ``altitude_term="literal"`` keeps that form for comparison.

    Args:
        distance_tm1: distance to the goal before the step, ``[*B]``, m.
        distance_t: the same after the step.
        altitude_t: height z, ``[*B]``, m.
        heading_deg_t: h, angle between the UAV's head and the goal, ``[*B]``, degrees in [0, 360).
        elevation_deg_t: g, angle between the UAV's position and the goal, ``[*B]``, degrees in [0, 360).
        arrived_t: bool ``[*B]``.
        collided_t: bool ``[*B]``; wins where both are true.
        weights: w_1 to w_4.
        flight_level: p_approAlt, m.
        collided_reward: r_collided (-50, or -10 with LifeGuard).
        arrived_reward: added on arrival; 0 is Eq. 3.6.
        altitude_term: ``"absolute"`` or ``"literal"``.

    Returns:
        The terms whose sum is the reward, each ``[*B]``: progress, altitude, heading, elevation, arrival, collision.

    Examples:
        >>> t = torch.tensor
        >>> terms = navigation_terms(t(5.0), t(4.75), t(3.5), t(90.0), t(0.0), t(False), t(False))
        >>> [round(term.item(), 2) for term in terms.values()]
        [2.0, 1.0, 0.25, 0.5, 0.0, 0.0]
    """
    w_distance, w_altitude, w_heading, w_elevation = weights
    deviation = (altitude_t - flight_level) / flight_level
    if altitude_term == "absolute":
        deviation = deviation.abs()
    terms = {
        "progress": w_distance * (distance_tm1 - distance_t),
        "altitude": w_altitude * (1 - deviation),
        "heading": w_heading * (1 - fold_degrees(heading_deg_t) / 180),
        "elevation": w_elevation * (1 - fold_degrees(elevation_deg_t) / 180),
    }
    return _with_ends(terms, arrived_t, collided_t, arrived_reward, collided_reward)


def navigation_reward(*quantities: Tensor, **options: Any) -> Tensor:
    """The sum ``[*B]`` of :func:`navigation_terms`, which takes the same arguments.

    Examples:
        >>> t = torch.tensor
        >>> navigation_reward(t(5.0), t(4.75), t(3.5), t(90.0), t(0.0), t(False), t(False)).item()
        3.75
    """
    return total(navigation_terms(*quantities, **options))


class SumOfTerms(Shown, Transform):
    """Reads quantities before and after a step and writes their reward: the sum of what :meth:`terms` gives."""

    @abstractmethod
    def terms(self, before: TensorDictBase, after: TensorDictBase) -> dict[str, Tensor]:
        """The terms of the reward, each ``[*B, 1]``, by name, of what was before and after steps ``[*B]``."""

    def _quantities(self, before: TensorDictBase, after: TensorDictBase) -> list[Tensor]:
        """The first in-key's value before the step, and all values after it."""
        return [entry(before, self.in_keys[0], self), *(entry(after, key, self) for key in self.in_keys)]

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.out_keys[0], total(self.terms(tensordict, next_tensordict)))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Recomputes the reward of stored transitions (root and ``"next"`` must hold the in-keys)."""
        return tensordict.set("next", self._step(tensordict, entry(tensordict, "next", self)))

    def transform_reward_spec(self, reward_spec: TensorSpec) -> TensorSpec:
        """An unbounded float under the out-key, in the place of an environment's own reward or beside it."""
        key, known = self.out_keys[0], reward_spec.keys(True, True)
        like = reward_spec[key if key in known else next(iter(known))]
        reward_spec[key] = Unbounded(shape=like.shape, dtype=like.dtype, device=like.device)
        return reward_spec


def terms_of(env: TransformedEnv) -> RewardTerms | None:
    """What gives the named terms of an environment's reward; None where it names none, or keeps not what they read.

    Examples:
        >>> from uavrl.envs import NavigationEnv
        >>> env = TransformedEnv(NavigationEnv(num_uavs=2), TraditionalReward())
        >>> steps = env.rollout(3)
        >>> list(terms_of(env)(steps, steps["next"]))
        ['progress', 'arrival', 'collision']
    """
    kept = {key for spec in (env.observation_spec, env.full_done_spec) for key in spec.keys(True, True)}
    part = next((part for part in env.transform.modules() if hasattr(part, "terms")), None)
    return part.terms if part is not None and kept.issuperset(part.in_keys) else None


class TraditionalReward(SumOfTerms):
    """The thesis's "TR" (Chansuparp (2022), Eq. 2.15): the sum of :func:`traditional_terms`.

    Args:
        arrived_reward: r_g.
        collided_reward: r_c.
        distance: key of the distance to the goal, m.
        arrived, collided: keys of the bools that say how an episode has ended.
        out_key: where the reward goes.

    Raises:
        KeyError: when a key is missing from the data.

    Examples:
        >>> from tensordict import TensorDict
        >>> after = TensorDict(distance=torch.ones(1), arrived=torch.tensor([False]), collided=torch.tensor([False]))
        >>> TraditionalReward()(TensorDict(distance=torch.full((1,), 1.5), next=after))["next", "reward"]
        tensor([0.5000])
    """

    def __init__(
        self,
        arrived_reward: float = 50.0,
        collided_reward: float = -50.0,
        *,
        distance: NestedKey = "distance",
        arrived: NestedKey = "arrived",
        collided: NestedKey = "collided",
        out_key: NestedKey = "reward",
    ) -> None:
        super().__init__(in_keys=[distance, arrived, collided], out_keys=[out_key])
        self.arrived_reward, self.collided_reward = arrived_reward, collided_reward

    def terms(self, before: TensorDictBase, after: TensorDictBase) -> dict[str, Tensor]:
        """As :func:`traditional_terms` gives them."""
        return traditional_terms(
            *self._quantities(before, after), arrived_reward=self.arrived_reward, collided_reward=self.collided_reward
        )


class NavigationReward(SumOfTerms):
    """The thesis's reward for navigation (Chansuparp (2022), Eq. 3.6), see :func:`navigation_terms`.

    Args:
        weights, flight_level, collided_reward, arrived_reward, altitude_term: as in :func:`navigation_terms`.
        distance, altitude, heading, elevation: keys of what it reads, in m and degrees.
        arrived, collided: keys of the bools that say how an episode has ended.
        out_key: where the reward goes.

    Raises:
        ValueError: for another number of weights than four, or an unknown ``altitude_term``.
        KeyError: when a key is missing from the data.

    Examples:
        >>> from uavrl.envs import NavigationEnv
        >>> env = TransformedEnv(NavigationEnv(num_uavs=2), NavigationReward())
        >>> bool((env.rollout(3)["next", "reward"] != 0).all())
        True
    """

    def __init__(
        self,
        weights: tuple[float, float, float, float] = (8.0, 1.0, 0.5, 0.5),
        flight_level: Positive = VEHICLE.flight_level,
        collided_reward: float = -50.0,
        arrived_reward: float = 0.0,
        altitude_term: AltitudeTerm = "absolute",
        *,
        distance: NestedKey = "distance",
        altitude: NestedKey = "altitude",
        heading: NestedKey = "heading_deg",
        elevation: NestedKey = "elevation_deg",
        arrived: NestedKey = "arrived",
        collided: NestedKey = "collided",
        out_key: NestedKey = "reward",
    ) -> None:
        if len(weights) != 4:
            raise ValueError(f"NavigationReward takes four weights w_1 to w_4, got {len(weights)}.")
        if altitude_term not in ("absolute", "literal"):
            raise ValueError(f"altitude_term must be 'absolute' or 'literal', got {altitude_term!r}.")
        super().__init__([distance, altitude, heading, elevation, arrived, collided], [out_key])
        self.weights = tuple(weights)
        self.flight_level = flight_level
        self.arrived_reward, self.collided_reward = arrived_reward, collided_reward
        self.altitude_term: AltitudeTerm = altitude_term

    def terms(self, before: TensorDictBase, after: TensorDictBase) -> dict[str, Tensor]:
        """As :func:`navigation_terms` gives them."""
        return navigation_terms(
            *self._quantities(before, after),
            weights=self.weights,
            flight_level=self.flight_level,
            collided_reward=self.collided_reward,
            arrived_reward=self.arrived_reward,
            altitude_term=self.altitude_term,
        )
