"""What a flight does when something fails: `uavrl-sitl` with faults and `uavrl-fly`, over loopback UDP, in real time.

    python benchmarks/faults.py [--policy FOLDER] [--task 3] [--only NAME]... [--json FILE]

Each fault begins 2 s after the first set-point that is obeyed, where it does not last from the start. The table says
whether the flight goes on, holds (zeros, then it goes on) or ends (zeros, then nothing is sent), after which time from
the fault the first zeros or nothing were sent, by the flight log, and how the simulated vehicle fared. The first flight
is always one without a fault. Without `--policy` the packaged `best` is exported first.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from common import machine
from loopback import PORTS, exported, flown

from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.logged_flight import LoggedFlight
from uavrl_onboard.flight.safety import SafetyState

BEGINS = 2.0  # s after the first obeyed set-point
KEY = b"k" * 32
_FLIES = (SafetyState.FLYING, SafetyState.FENCED)
_QUICK = ("perception.lidar.max_range=20", "env.max_steps=200", "patience=30")
_AT = f"{BEGINS:g}"
_EVER, _MOMENT = f"[{_AT},1000]", f"[{_AT},2.3]"


class Fault(NamedTuple):
    """One row of the table."""

    name: str
    keys: tuple[str, ...]  #: of uavrl-sitl
    begins: float | None = BEGINS  #: s after the first obeyed set-point; None for from the start
    fly: tuple[str, ...] = ()  #: keys of uavrl-fly


FAULTS = (
    Fault("none", (), None),
    Fault("a tenth of the packets is lost, a tenth comes late", ("faults.lose=0.1", "faults.reorder=0.1"), None),
    Fault("LiDAR silent for 0.4 s", (f"faults.lidar_silent=[{_AT},2.4]",)),
    Fault("LiDAR silent for good", (f"faults.lidar_silent={_EVER}",)),
    Fault("half of the scan cut off", (f"faults.half_scan={_EVER}",)),
    Fault("scan repeated", (f"faults.frozen_scan={_EVER}",)),
    Fault("LiDAR turned by 90°", (f"faults.turned_scan={_EVER}",)),
    Fault("second sensor on the port", (f"faults.second_sensor={_EVER}",)),
    Fault("another model's packets", ("faults.product=33",), None),
    Fault("pose silent for 0.3 s", (f"faults.pose_silent={_MOMENT}",)),
    Fault("pose silent for good", (f"faults.pose_silent={_EVER}",)),
    Fault("pose sent 5 times per second", (f"faults.slow_pose={_EVER}",)),
    Fault("position off by 20 m for 0.3 s", (f"faults.pose_jump={_MOMENT}",)),
    Fault("position at the goal for 0.3 s", (f"faults.pose_jump={_MOMENT}", "faults.jump=GOAL")),
    Fault("position off by 20 m for good", (f"faults.pose_jump={_EVER}",)),
    Fault("position drifts by 1.5 m/s", (f"faults.pose_drift={_EVER}", "faults.drift=[1.5,0,0]")),
    Fault("position drifts by 0.3 m/s", (f"faults.pose_drift={_EVER}", "faults.drift=[0.3,0,0]")),
    Fault("pose stands still", (f"faults.frozen_pose={_EVER}",)),
    Fault("estimator reset", (f"faults.reset={_AT}",)),
    Fault("autopilot's clock steps back by 3 s", (f"faults.clock_step=[{_AT},-3]",)),
    Fault("autopilot's clock steps forward by 3 s", (f"faults.clock_step=[{_AT},3]",)),
    Fault("a camera's heartbeats", ("faults.camera=true",), None),
    Fault("link signed, key unknown", ("faults.signing_key_file=KEY",), None),
    Fault("link signed, key given", ("faults.signing_key_file=KEY",), None, ("signing_key_file=KEY",)),
    Fault("pilot takes over", (f"pilot_takes_over={_AT}",)),
)


class Answer(NamedTuple):
    """How a flight answered to its fault."""

    verdict: str  #: goes on, holds, ends, or never begins
    zeros_after: float | None  #: s from the fault to the first cycle without a velocity; None: there was none
    reason: str  #: of that cycle; of a flight that never begins, of most cycles


def answer(cycles: Iterable[tuple[float, FlightCycle]], fault: float | None) -> Answer:
    """How a flight answered.

    Args:
        cycles: of the flight until it has arrived, each with its time of the day in s.
        fault: when that began; None for from the start.
    """
    flew, zeros = False, None
    last: FlightCycle | None = None
    reasons = Counter[str]()
    for time, cycle in cycles:
        flies = cycle.status.state in _FLIES
        if zeros is None and flew and not flies and (fault is None or time >= fault):
            zeros = (None if fault is None else time - fault), str(cycle.status.reason)
        flew, last = flew or flies, cycle
        reasons[str(cycle.status.reason)] += 1
    if last is None or not flew:
        return Answer("never begins", None, next((reason for reason, _ in reasons.most_common(1)), ""))
    if zeros is None:
        return Answer("goes on", None, "")
    return Answer("holds" if last.status.state in _FLIES else "ends", *zeros)


def until_arrival(folder: Path) -> Iterator[tuple[float, FlightCycle]]:
    """The cycles of a flight before it has arrived, with their time of the day."""
    log = LoggedFlight(folder / "flight.mcap")
    offset = 1e-9 * int(log.about["clock_offset_ns"])
    for cycle in log:
        if cycle.arrived:
            return
        yield cycle.time + offset, cycle


def row(
    fault: Fault, policy: Path, task: int, folder: Path, unhurt: dict[str, Any] | None = None, ports: Any = PORTS
) -> dict[str, Any]:
    """Flies with a fault; what came of it.

    Args:
        fault: the fault.
        policy: folder of an exported policy.
        task: number of the task.
        folder: for what the two programs write.
        unhurt: the row of a flight without a fault.
        ports: of LiDAR and autopilot.
    """
    key = folder.parent / "key"
    key.write_bytes(KEY)
    words = {"GOAL": "[0,0,0]" if unhurt is None else to_the_goal(unhurt), "KEY": str(key)}
    sitl, fly = (tuple(_put(each, words) for each in keys) for keys in ((*fault.keys, *_QUICK), fault.fly))
    vehicle, told = flown(policy, task, folder, sitl, ("seconds=40", "guards=none", *fly), ports)
    began = vehicle.get("began_at")
    begins = None if began is None or fault.begins is None else began + fault.begins
    found = answer(until_arrival(folder), begins)
    told_arrived = told["arrived_after_s"]
    return {
        "fault": fault.name,
        "keys": [*fault.keys, *fault.fly],
        **found._asdict(),
        "outcome": vehicle["outcome"] if vehicle.get("setpoints") else None,
        "arrived_after_s": told_arrived,
        "goal": vehicle["goal"],
        "start": vehicle["start"],
    }


def to_the_goal(unhurt: dict[str, Any]) -> str:
    """The way that is left to the goal when faults begin, about 2 m from the start, as a value of ``faults.jump``."""
    (x, y), (goal_x, goal_y) = unhurt["start"][:2], unhurt["goal"][:2]
    left = 1.0 - 2.0 / math.hypot(goal_x - x, goal_y - y)
    return f"[{left * (goal_x - x):.2f},{left * (goal_y - y):.2f},0]"


def _put(key: str, words: dict[str, str]) -> str:
    name, _, value = key.partition("=")
    return f"{name}={words.get(value, value)}"


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = ["| fault | the flight | zeros after | reason | the vehicle |", "|---|---|---|---|---|"]
    for each in rows:
        late = "" if each["zeros_after"] is None else f"{each['zeros_after']:.2f} s"
        reason = f"`{each['reason']}`" if each["reason"] else ""
        outcome = (each["outcome"] or "nothing was obeyed").replace("_", "-")
        lines.append(f"| {each['fault']} | {each['verdict']} | {late} | {reason} | {outcome} |")
    return "\n".join(lines)


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--policy", type=Path, help="a folder that uavrl-export wrote")
    parser.add_argument("--task", type=int, default=3)
    parser.add_argument("--only", action="append", default=[], help="name of a fault")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    found = machine()
    with tempfile.TemporaryDirectory() as made:
        policy = exported(args.policy, Path(made))
        chosen = [fault for fault in FAULTS if not args.only or fault.name in ("none", *args.only)]
        rows = list[dict[str, Any]]()
        for number, fault in enumerate(chosen):
            rows.append(row(fault, policy, args.task, Path(made) / str(number), rows[0] if rows else None))
            print(table(rows[-1:]).splitlines()[-1], flush=True)
    print(table(rows))
    if args.json is not None:
        args.json.write_text(json.dumps(found | {"flights": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
