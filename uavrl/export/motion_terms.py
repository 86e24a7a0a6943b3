"""What a contract says of a policy's sight of motion, read off the transforms of its training."""

from __future__ import annotations

from typing import Any

from uavrl.transforms import MovingObjects, Threats
from uavrl_onboard.perception.motion import OBJECT, rays, threats
from uavrl_onboard.perception.motion.sight import LARGEST_SIZE

POSE = {
    "velocity": "m/s: [3], of the vehicle in the world's axes",
    "attitude": "rad: roll, pitch and yaw; from the vehicle's axes to the world's is Rz(yaw) Ry(pitch) Rx(roll)",
    "moving_objects": "motion.objects times the numbers of motion.object, nearest first, 0 for none",
    "threats": "one for each of motion.threats.directions, and one for standing, see motion.threats.value",
}
UNITS = {"velocity": "m/s, over ground", "size": "m, the diagonal of the box around its points"}
FOUND = (
    "by uavrl_onboard MotionSight in each scan that comes motion.period s after the one before: a body that is at most "
    f"{LARGEST_SIZE:g} m large and moves at 1.5 to 8 m/s, within motion.max_range m of the sensor, once three scans "
    "have shown it; what has seen the same moving bodies otherwise will do. An episode begins without memory"
)
FRAME = "from the sensor, in level axes that are turned with the yaw alone: forward, left, up"
RAYS = (
    "of the cloud's points within max_range those count for which "
    "floor((-atan2(y, x) mod 360) / step - first) mod every is 0, in degrees; "
    "of a sensor whose rays are farther apart, those next to them"
)
THREAT = (
    "for a way v = speed * direction, or 0 for standing, a body at p with velocity w, the vehicle's velocity u, all "
    "turned by the yaw: with t = period, 2 * period, ..., steps * period; "
    "lost = lag * (1 - exp(-t / lag)); gap = v * (t - lost) + u * lost - p - w * t; "
    "apart = max(hypot(gap_x, gap_y) / wide, |gap_z| / high); share = t / (steps * period); it is the greatest of "
    "max(1.2 - 0.2 * share - apart, 0) * (1 - 0.5 * share) over t, plus 1 if any apart is below 1; and of all bodies "
    "the greatest, 0 without one"
)


def motion_terms(seen: MovingObjects, met: Threats) -> dict[str, Any]:
    """The part ``motion``, which :class:`uavrl_onboard.policy.contract.MotionTerms` reads."""
    step, first, every = rays.TERMS
    return {
        "max_range": seen.max_range,
        "objects": seen.objects,
        "object": [f"{name} ({UNITS.get(name.split()[-1], 'm')})" for name in OBJECT],
        "frame": FRAME,
        "found": FOUND,
        "period": seen.period,
        "rays": {"counts": RAYS, "step": step, "first": first, "every": every},
        "threats": {
            "speed": met.speed,
            "steps": threats.STEPS,
            "period": threats.PERIOD,
            "lag": threats.LAG,
            "wide": threats.WIDE,
            "high": threats.HIGH,
            "value": THREAT,
            "directions": [[round(x, 9) + 0.0 for x in row] for row in threats.DIRECTIONS.tolist()],
        },
    }
