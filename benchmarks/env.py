"""Cost of one UAV's environment step, all included up to the collector's output, and where it goes.

Run `python benchmarks/env.py [--json FILE] [--scaling]`. The row "uavrl" is the default experiment of `uavrl-train`
before its first update: whole flights with random actions, full VLP-16 scans (28,928 rays), their reduction, reward
and frames, through TorchRL's collector as training builds it. The bare rows are what no implementation on PyBullet and
Embree can do without: 24 calls of `stepSimulation` for the same vehicles in the same world, and one Embree call on
ready-made rays of the same scans with the same range, both at states of such flights. Everything runs on one thread.
Rows are interleaved and repeated; medians count. The profile comes from a pass of its own.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bare import FleetState, bare_physics, bare_rays
from common import machine
from flights import Row, flights_in, flying, mean_of, measure, settings
from profiling import Stopwatch
from scaling import print_scaling, scaling
from torchrl.collectors import BaseCollector
from torchrl.envs import CatFrames

from uavrl.envs.bullet import pybullet
from uavrl.envs.lidar import Lidar
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.simulation import Simulation
from uavrl.evaluation.environment import make_env
from uavrl.transforms import NavigationObservation, NavigationReward, PointCloudReduction
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.lidar.vlp16 import NUM_RAYS

PHYSICS, RAYS = "bare PyBullet physics", "bare Embree rays"
COLLECTOR = "TorchRL: collector, TensorDict, TransformedEnv"
PARTS: dict[str, list[tuple[Any, str]]] = {
    "physics: stepSimulation": [(pybullet, "stepSimulation")],
    "physics: control, rotors, reading states, contacts": [(Simulation, "step"), (Simulation, "reset")],
    "rays: aiming, culling, casting, points": [(Lidar, "scan")],
    "reduction": [(PointCloudReduction, "_call")],
    "reward, observation, frames": [
        (NavigationReward, "_step"),
        (NavigationObservation, "_call"),
        (CatFrames, "_call"),
        (CatFrames, "_reset"),
    ],
    "NavigationEnv: tasks, goal angles, packing": [(NavigationEnv, "_step"), (NavigationEnv, "_reset")],
}


def profile(collector: BaseCollector, fly: Row) -> tuple[dict[str, float], list[FleetState]]:
    """Returns milliseconds per UAV step of each part of ``fly``, and states of its flights for the bare rows."""
    states: list[FleetState] = []
    stopwatch = Stopwatch(COLLECTOR)
    publish = Simulation._publish

    def publish_and_keep(simulation: Simulation) -> None:
        publish(simulation)
        kept = (simulation.position, simulation.lidar_position, simulation.rotation, simulation.velocity)
        states.append(FleetState(*(array.copy() for array in kept)))

    Simulation._publish = publish_and_keep  # type: ignore[method-assign, assignment]
    try:
        with stopwatch.watching(PARTS):
            fly()  # warms up
            states.clear()
            before = collector.state_dict()["frames"]
            stopwatch.reset()
            fly()
            seconds = stopwatch.stop()
    finally:
        Simulation._publish = publish  # type: ignore[method-assign]
    flown = collector.state_dict()["frames"] - before
    parts = {part: seconds[part] / flown * 1e3 for part in [*PARTS, COLLECTOR]}
    return parts, [states[i] for i in np.random.default_rng(0).permutation(len(states))]


def measured(uavs: int, steps: int, repeats: int) -> dict[str, Any]:
    """Times the rows and the parts of ours."""
    config = settings(uavs)
    env = make_env(config.env, config.perception, config.reward, seed=config.seed)
    collector, world = flights_in(env, config), env.base_env.world
    fly = flying(collector, steps)
    parts, states = profile(collector, fly)
    calls = max(steps // uavs // 8, 1)  # the bare rows are steadier and need fewer
    rows: dict[str, Row] = {
        "uavrl": fly,
        PHYSICS: mean_of(bare_physics(world, env.base_env.airframe, states), calls),
        RAYS: mean_of(bare_rays(world, config.perception.lidar.max_range, states), calls),
    }
    milliseconds = measure(rows, repeats)
    collector.shutdown()
    ours, bare = milliseconds["uavrl"], milliseconds[PHYSICS] + milliseconds[RAYS]
    return {"ms_per_uav_step": ours, "vs_bare": ours / bare, "rows": milliseconds, "profile": parts}


def print_result(result: dict[str, Any]) -> None:
    """Prints rows and profile."""
    print(f"{'':54}{'ms per UAV step':>16}")
    for name, value in result["rows"].items():
        print(f"{name:54}{value:16.3f}")
    print(f"\nuavrl takes {result['vs_bare']:.2f} times as long as bare physics and rays together\n")
    print(f"{'where the time goes (a pass of its own)':54}{'ms per UAV step':>16}{'share':>9}")
    for name, value in result["profile"].items():
        print(f"{name:54}{value:16.3f}{value / sum(result['profile'].values()):9.1%}")


def main() -> None:
    """Measures, prints the tables, and writes the JSON file if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--uavs", type=int, default=8, help="UAVs in the world")
    parser.add_argument("--repeats", type=int, default=30, help="rounds; a tenth of them in the sweeps")
    parser.add_argument(
        "--steps", type=int, default=1024, help="least UAV steps of each row in a round; half in the sweeps"
    )
    parser.add_argument("--scaling", action="store_true", help="also measure against UAVs, range, obstacles, processes")
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)  # the same flights at each call
    about = machine()
    print(f"{args.uavs} UAVs, {NUM_RAYS} rays per scan, one thread, median of {args.repeats} rounds\n")
    result = measured(args.uavs, args.steps, args.repeats)
    print_result(result)
    if args.scaling:
        result["scaling"] = scaling(args.uavs, max(args.steps // 2, 1), max(args.repeats // 10, 1))
        print_scaling(result["scaling"])
    if args.json:
        result |= {"uavs": args.uavs, "rays_per_scan": NUM_RAYS, "threads": 1, "machine": about}
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
