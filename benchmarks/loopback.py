"""The whole chain in two processes: `uavrl-sitl` and `uavrl-fly` over loopback UDP, in real time.

    python benchmarks/loopback.py [--policy FOLDER] [--tasks 20] [--fly KEY=VALUE]... [--json FILE] [SITL_KEY=VALUE]...

Packets of a VLP-16 and MAVLink are all that the two share, besides the goal. The outcomes are those that `uavrl-sitl`
tells; the latency is from a scan's last packet to the set-point, of all cycles of all flights in which the policy flew.
The same tasks are then flown in the library, by `uavrl-evaluate policy=FOLDER`. Without `--policy` the packaged `best`
is exported first.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import machine

from uavrl.errors import UavrlError
from uavrl.runs.episodes import wilson
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.flight.logged_flight import LoggedFlight
from uavrl_onboard.flight.safety import SafetyState

PORTS = (23_680, 24_540)  # of LiDAR and autopilot
LETTERS = {"success": "S", "collision": "C", "time_out": "T"}
PATIENCE = 60.0  # s for the simulator to begin
LONGEST = 120.0  # s of one flight


def started(module: str, *arguments: str, folder: Path) -> subprocess.Popen[str]:
    """One of our commands in a process of its own, which writes what it prints to NAME.log."""
    with (folder / f"{module.rpartition('.')[2]}.log").open("w", encoding="utf-8") as log:
        return subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdout=log,
            stderr=subprocess.STDOUT,
            cwd=folder,
            text=True,
        )


def exported(policy: Path | None, folder: Path) -> Path:
    """The folder of a policy; without one the packaged ``best`` is exported into ``folder`` first."""
    if policy is None:
        policy = folder / "best"
        export = ["policy=best", f"output={policy}"]
        subprocess.run([sys.executable, "-m", "uavrl.cli.export", *export], check=True)
    return policy.resolve()


def flown(
    policy: Path, task: int, folder: Path, sitl: tuple[str, ...] = (), fly: tuple[str, ...] = (), ports: Any = PORTS
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Flies one task; what `uavrl-sitl` and what `uavrl-fly` write about it."""
    folder.mkdir(parents=True)
    lidar, autopilot = (f"udp://127.0.0.1:{port}" for port in ports)
    both = (f"lidar={lidar}", f"autopilot={autopilot}")
    vehicle = started("uavrl.cli.sitl", f"task={task}", "json=task.json", *both, *sitl, folder=folder)
    try:
        begun = time.monotonic()
        while not (folder / "task.json").exists():
            if vehicle.poll() is not None or time.monotonic() - begun > PATIENCE:
                raise UavrlError(f"uavrl-sitl has not begun: see {folder / 'sitl.log'}.")
            time.sleep(0.05)
        goal = json.loads((folder / "task.json").read_text(encoding="utf-8"))["goal"]
        where = f"goal=[{','.join(map(str, goal))}]"
        often = ("model=VLP16", "set_mode=true", "hold=0.5", f"seconds={LONGEST - 20:g}", "json=flight.json")
        pilot = started("uavrl_onboard.cli.fly", f"policy={policy}", where, *often, *both, *fly, folder=folder)
        try:
            vehicle.wait(LONGEST)
            pilot.wait(5.0)
        except subprocess.TimeoutExpired:
            pilot.terminate()  # the vehicle has ended, and nothing flies
            pilot.wait()
    finally:
        vehicle.kill()
    told = [json.loads((folder / name).read_text(encoding="utf-8")) for name in ("task.json", "flight.json")]
    return told[0], told[1]


def latencies(folder: Path) -> list[float]:
    """Of the cycles in which the policy flew, in s."""
    cycles = LoggedFlight(folder / "flight.mcap")
    flying = [cycle for cycle in cycles if cycle.status.state in (SafetyState.FLYING, SafetyState.FENCED)]
    return [cycle.latency for cycle in flying if cycle.latency is not None]


def in_the_library(policy: Path, tasks: int, output: Path) -> str:
    """The outcomes of the same tasks in `uavrl-evaluate`, a letter each."""
    what = ["env=static", "valleys=training", f"episodes={tasks}", f"output={output}", "progress=false"]
    subprocess.run(
        [sys.executable, "-m", "uavrl.cli.evaluate", f"policy={policy}", *what], check=True, stdout=subprocess.DEVNULL
    )
    return str(json.loads(output.read_text(encoding="utf-8"))["outcomes"])


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sitl", nargs="*", default=[], help="keys of uavrl-sitl")
    parser.add_argument("--policy", type=Path, help="a folder that uavrl-export wrote")
    parser.add_argument("--tasks", type=int, default=20)
    parser.add_argument("--fly", action="append", default=[], help="a key of uavrl-fly")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    found = machine()
    with tempfile.TemporaryDirectory() as made:
        policy = exported(args.policy, Path(made))
        rows, late = [], list[float]()
        for task in range(args.tasks):
            folder = Path(made) / str(task)
            vehicle, flight = flown(policy, task, folder, tuple(args.sitl), tuple(args.fly))
            ended = LETTERS.get(vehicle["outcome"] or "", "-")
            rows.append({"task": task, "outcome": ended, "vehicle": vehicle, "flight": flight})
            late += latencies(folder)
            print(f"task {task}: {vehicle['outcome']}, {flight['latency_ms']['median']} ms (median)", flush=True)
        outcomes = "".join(str(row["outcome"]) for row in rows)
        library = in_the_library(policy, args.tasks, Path(made) / "library.json")
    median, p99 = np.percentile(1000.0 * np.array(late), [50, 99]).round(2).tolist()
    found |= {"outcomes": outcomes, "library": library, "latency_ms": {"median": median, "p99": p99}}
    found |= {"success": wilson(outcomes.count("S"), args.tasks), "cycles": len(late), "flights": rows}
    print(f"over loopback {outcomes}, in the library {library}")
    print(f"{len(late):,} set-points, {median:.1f} ms (median), {p99:.1f} ms (99 %) after their scan's last packet")
    if args.json is not None:
        args.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
