"""What a policy reads of moving objects: where they are, and how near they would come on each way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import Columns, world_to_yaw
from uavrl_onboard.perception.motion import MotionSight
from uavrl_onboard.perception.motion.rays import ScanPattern
from uavrl_onboard.perception.motion.sight import scales
from uavrl_onboard.perception.motion.threats import DIRECTIONS, GREATEST, greatest_threats, straight_on

if TYPE_CHECKING:
    from uavrl_onboard.policy.contract_parts import MotionTerms


class MotionReader:
    """Follows what moves around one vehicle, as :class:`uavrl.transforms.NavigationState` does in training.

    Args:
        terms: what the contract says of it.
        pattern: how the rays of the LiDAR lie.
    """

    def __init__(self, terms: MotionTerms, pattern: ScanPattern = ScanPattern()) -> None:  # noqa: B008 - a tuple
        self._period, self._pattern = terms.period, pattern
        self._sight = MotionSight(1, terms.max_range, terms.objects, terms.period, pattern)
        self._scales = np.array(scales(terms.max_range), np.float32)
        standing = np.zeros((1, 3), np.float32)
        self._commanded = np.concatenate([np.float32(terms.threats.speed) * DIRECTIONS, standing])

    def reset(self) -> None:
        """Forgets what was seen."""
        self._sight.reset(np.ones(1, bool))

    def checked(
        self,
        velocity: Sequence[float] | np.ndarray | None,
        attitude: Sequence[float] | np.ndarray | None,
        elapsed: float | None,
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Velocity and attitude, if these are three finite numbers each, and the time since the last scan."""
        told = [np.full(1, np.nan) if each is None else np.asarray(each, np.float64) for each in (velocity, attitude)]
        if not all(each.shape == (3,) and np.isfinite(each).all() for each in told):
            raise UavrlError(
                "This policy sees what moves, for which it needs velocity (3 finite numbers, m/s in the world's axes) "
                f"and attitude (roll, pitch and yaw in rad), got {velocity} and {attitude}: fly it by what tells both."
            )
        elapsed = self._period if elapsed is None else float(elapsed)
        if not 0.0 < elapsed < np.inf:
            raise UavrlError(f"elapsed must be a finite time above 0 s, got {elapsed}: give that between two scans.")
        return told[0], told[1], elapsed

    def __call__(self, cloud: np.ndarray, velocity: np.ndarray, attitude: np.ndarray, elapsed: float) -> np.ndarray:
        """Takes in another scan ``[P, 3]``; returns objects and threats, scaled, ``float32``."""
        scan = Columns.of(cloud)
        searched = scan.rows(self._pattern.searched(scan))
        objects = self._sight.look(searched[None], velocity[None], attitude[None], elapsed=elapsed)
        own = world_to_yaw(velocity[None].astype(np.float32), attitude[None, 2].astype(np.float32))
        threats = greatest_threats(self._commanded[None], own, *straight_on(objects.reshape(1, -1)))
        return np.concatenate([(objects / self._scales).ravel(), threats[0] / GREATEST]).astype(np.float32)
