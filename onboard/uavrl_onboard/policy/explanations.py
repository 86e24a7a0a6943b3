"""The sentences of ``contract.json`` that explain its numbers to whoever writes another program."""

from __future__ import annotations

from uavrl_onboard.guards.evade import CHOICES
from uavrl_onboard.guards.shield import Shield
from uavrl_onboard.perception.cells import Statistic
from uavrl_onboard.perception.motion import OBJECT
from uavrl_onboard.perception.motion.sight import LARGEST_SIZE
from uavrl_onboard.perception.motion.threats import PERIOD, STEPS
from uavrl_onboard.perception.motion.tracks import CONFIRMED, SPEEDS
from uavrl_onboard.perception.reductions import Reduction
from uavrl_onboard.vehicle import DECELERATION, REACTION, VEHICLE

MOMENT = "the cloud and the pose belong to the same moment, and the vehicle flies the action immediately"

CLOUD_FRAME = "sensor: x forward, y left, z up; fixed to the vehicle, so that it tilts with the vehicle"
SENSOR = "one revolution of a Velodyne VLP-16; the points may come in any order"
FIELD_OF_VIEW = "degrees: the rightmost, leftmost, lowest and highest ray; 0 is ahead, left and up are positive"
OUTSIDE = "cells_see is written as field_of_view: points more than 0.5 degrees outside do not enter the cells"
REPEATS = (
    "whether each scan has the same rays. If not, all returns are searched for motion, and three of the last four "
    "scans must have seen through where something moves. If so, two must, and one of a VLP-16"
)
POSITION = "sensor_position is measured in body axes from the centre of the airframe"
MISS = "a point with a coordinate that is not finite, or with x² + y² + z² outside squared_range or at one of its ends"

CELL: dict[Reduction, str] = {
    "truncated_icosahedron": "a point p belongs to the cell whose centre, offsets[i] * directions[i], is nearest; it "
    "belongs to no cell if directions[i] · p > offsets[i] for any i",
    "range_image": "angles in degrees: column = round(atan2(y, x) / width) mod columns; row = number of row_borders "
    "below atan2(z, hypot(x, y)); cell = rows * column + row",
}
LENGTH: dict[Statistic, str] = {
    "face": "the distance from the point to the centre of its cell, offsets[i] * directions[i]",
    "range": "the distance from the sensor to the point",
    "proximity": "the distance from the sensor to the point",
}
_MINIMUM = (
    ", where m is the minimum length over the points of the cell, clipped to interval; 0 if the cell has no points"
)
VALUE: dict[Statistic, str] = dict.fromkeys(("face", "range"), f"m{_MINIMUM}")
VALUE["proximity"] = f"radius - m{_MINIMUM}"

POSE = {
    "axes": "world axes with z up; x, y and z are the position of the centre of the airframe; yaw is its heading, "
    "counter-clockwise from the x axis",
    "altitude": "m: z, above the mean ground level",
    "heading": "degrees in [0, 360): atan2(goal_y - y, goal_x - x) - yaw; 0 is ahead, 90 is left",
    "elevation": "degrees in [0, 360): atan2(goal_z - z, hypot(goal_x - x, goal_y - y)); 0 is level, 90 is above",
    "goal": "the centre of the goal's cylinder, half-way between the ground and the ceiling",
    "last_action": "the previous action, as it was flown; zeros at the first step of an episode",
}
MOTION_POSE = {
    "velocity": "m/s: [3], the velocity of the vehicle in world axes",
    "attitude": "rad: roll, pitch and yaw; Rz(yaw) Ry(pitch) Rx(roll) rotates from body axes to world axes",
    "moving_objects": "the numbers of motion.object for each of motion.objects objects, nearest first; zeros if there "
    "are fewer objects",
    "threats": "one value for each of motion.threats.directions, then one for hovering; see motion.threats.value",
}
SCALING = "((value + shift) mod modulo) / divisor + offset; without mod if modulo is null"
DIVISORS = "; a list holds one divisor for each number"

ORDER = "oldest observation first"

CLIP = "to low and high, before the vehicle flies it"
ACTION_FRAME = "yaw-aligned body frame: world axes rotated about the vertical by the yaw only, level at any tilt"
HOLDS = "until the next action"

MEMORY = (
    "the network also reads size numbers, float32, as its input of this name, and gives as many as its output of this "
    "name, which are the input of the next step of the same vehicle. They are initial at the first step of an episode, "
    "which begins at take-off and wherever the policy has not acted for a while. Call the network once per step, and "
    "keep the numbers of a vehicle apart from those of others"
)

_UNITS = {"velocity": "m/s, over ground", "size": "m, the diagonal of the bounding box of its points"}
OBJECT_NUMBERS = [f"{name} ({_UNITS.get(name.split()[-1], 'm')})" for name in OBJECT]
OBJECT_FRAME = "relative to the sensor, in level axes that are rotated by the yaw only: forward, left, up"
OBJECTS_FOUND = (
    "MotionSight of uavrl_onboard finds the objects in scans that are motion.period s apart: bodies of at most "
    f"{LARGEST_SIZE:g} m that move at {SPEEDS[0]:g} to {SPEEDS[1]:g} m/s within motion.max_range m of the sensor, once "
    f"{CONFIRMED} scans have shown them. You can use any other detector that finds the same moving bodies. It "
    "remembers nothing from before the episode"
)
RAYS = (
    "of the points within max_range, use those for which "
    "floor((-atan2(y, x) mod 360) / step - first) mod every is 0, in degrees; "
    "for a sensor with fewer rays, use the rays next to these angles"
)
ALL_RETURNS = "use all points within max_range"
THREAT = (
    "for a candidate velocity v = speed * direction, or 0 for hovering, an object at p with velocity w, and the "
    "velocity u of the vehicle, all rotated by the yaw, at the times t = period, 2 * period, ..., steps * period: "
    "lost = lag * (1 - exp(-t / lag)); gap = v * (t - lost) + u * lost - p - w * t; "
    "apart = max(hypot(gap_x, gap_y) / wide, |gap_z| / high); share = t / (steps * period); the threat of the object "
    "is the maximum over t of max(1.2 - 0.2 * share - apart, 0) * (1 - 0.5 * share), plus 1 if apart is below 1 at any "
    "t; the value is the maximum over all objects, 0 if there is none"
)

GUARDS_APPLIED = (
    "guards are filters between the policy and the vehicle, applied in the order map, evasion, shield; those that are "
    "listed here are on by default, as uavrl_onboard.guards has them. radius and height are those of the vehicle's "
    "hull in m, a level cylinder"
)
GUARD_MAP = (
    "the heading that the policy reads is the angle to a waypoint. Every every-th scan enters a grid with cells of "
    "cell m: the returns within sight m of the sensor and at most level m above or below the flight level, which is "
    "the divisor of altitude, without those of moving objects. The grid forgets cells that are more than reach m away. "
    "Navigator of uavrl_onboard searches the quickest path to the goal that is wide enough for the vehicle, where "
    "unseen cells count as free. The waypoint is the last point of the path in a straight line, or else the point "
    "ahead m along the path. The grid is empty at the start of an episode"
)
GUARD_EVASION = (
    f"a velocity that would meet one of the nearest moving objects within {STEPS * PERIOD:g} s, if they fly straight "
    f"on or level off, is replaced by the best of {CHOICES} others. MotionSight of uavrl_onboard detects the objects "
    "up to sight m away"
)
GUARD_SHIELD = (
    f"the velocity towards each point of the scan within {Shield.sight:g} m, except those of moving objects, is at "
    "most gap / time. The gap is measured from the hull with margin m around it, after lag s of flight at the present "
    f"velocity; it is at least 0. Where the limit v in action.high is above {VEHICLE.velocity_limit:g} m/s, points "
    f"count within {Shield.sight:g} + {REACTION:g} * v + v² / (2 * {DECELERATION:g}) m, and the velocity towards a gap "
    f"above {DECELERATION:g} * time² is at most sqrt(({DECELERATION:g} * time)² + 2 * {DECELERATION:g} * (gap - "
    f"{DECELERATION:g} * time²))"
)
