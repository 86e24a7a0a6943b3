"""The cost of an environment step with each LiDAR and in other worlds, beside the VLP-16 in the valley.

Run `python benchmarks/worlds.py [--cloud POINTS] [--json FILE]`. All rows fly eight vehicles with the same random
actions, on one thread and up to the policy's observation. Rows are interleaved and repeated; medians count.
`--cloud 5000000` instead builds the world of a point cloud with that many points, with an empty cache, and prints the
time and the memory that this takes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from common import experiment, machine
from flights import Row, measure, stepping

from uavrl.envs import NavigationEnv
from uavrl.envs.sensors import SENSORS
from uavrl.evaluation.environment import make_env
from uavrl.runs.cache import FOLDER
from uavrl.training.build import with_stride
from uavrl_onboard.cli.process import one_sentence

VALLEY = "vlp16 in the valley"
ROWS = {
    VALLEY: [],
    **{f"{name} in the valley": [f"env.lidar={name}"] for name in SENSORS if name != "vlp16"},
    "vlp16 with trainer.lidar_stride=4": ["trainer.lidar_stride=4"],
    "vlp16 in the forest": ["env=forest"],
    "vlp16 in rooms": ["env=rooms"],
}


def flying(name: str, steps: int, uavs: int) -> Row:
    """Return a row that measures milliseconds per vehicle step."""
    settings = experiment("perception=range_image", *ROWS[name])
    env = make_env(settings.env, with_stride(settings), settings.reward, seed=settings.seed, num_uavs=uavs)
    return stepping(env, steps, uavs)


def cloud_of(count: int, folder: Path) -> Path:
    """Write a file of ``count`` points: level ground of 60 m by 60 m with 60 pillars."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-30, 30, (count // 2, 2)), rng.normal(0, 0.02, count // 2)])
    around = rng.uniform(0, 2 * np.pi, count - len(ground))
    middles = rng.uniform(-28, 28, (60, 2))[rng.integers(60, size=len(around))]
    pillars = np.column_stack(
        [
            middles + 0.4 * np.column_stack([np.cos(around), np.sin(around)]),
            rng.uniform(0, 6, len(around)),
        ]
    )
    file = folder / "cloud.npy"
    np.save(file, np.concatenate([ground, pillars]).astype(np.float32))
    return file


def build_cloud(count: int) -> dict[str, float]:
    """Return the seconds until the first step is possible, and the peak memory before and after."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ[FOLDER] = folder
        file = cloud_of(count, Path(folder))
        settings = experiment("env=cloud", f"env.world.file={file}", "env.world.voxel=0.2")
        before, begun = _peak(), time.perf_counter()
        env = NavigationEnv(8, world=settings.env.world, lidar=settings.perception.lidar)
        env.reset()
        seconds, faces = time.perf_counter() - begun, sum(len(mesh.faces) for mesh in env.world.meshes)
        after = _peak()
        env.close()
    return {"points": count, "seconds": seconds, "triangles": faces, "gb_before": before, "gb": after}


def _peak() -> float:
    """Return the peak memory of this process in GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> None:
    """Measure, and print the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--uavs", type=int, default=8)
    parser.add_argument("--steps", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=6)
    parser.add_argument("--cloud", type=int, help="points of the cloud to build instead")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    about = machine()
    if args.cloud:
        found = build_cloud(args.cloud)
        print(", ".join(f"{name.replace('_', ' ')} {value:,.2f}" for name, value in found.items()))
    else:
        found = measure({name: flying(name, args.steps, args.uavs) for name in ROWS}, args.repeats)
        for name, value in found.items():
            print(f"{name:36} {value:6.2f} ms per vehicle step, {value / found[VALLEY]:.2f} times")
    if args.json:
        kind = "cloud" if args.cloud else "ms_per_uav_step"
        content = {"machine": about, "uavs": args.uavs, kind: found}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
