"""Speed of the LiDAR and its reduction beside bare Embree and PyBullet's rays.

Run `python benchmarks/lidar.py [--json FILE]`. All rows cast the same rays: full VLP-16 scans (28,928 rays) of UAVs at
3.5 m in the default valley, at the starts of random tasks with random yaws and small tilts, from a fixed seed. The bare
Embree and PyBullet rows get ready-made rays and return ranges only; ours also turn the rays, build the points and
reduce them. "cut" is a range of 4 m (the circumradius of the reduction), "uncut" is 100 m; PyBullet's rays are uncut.
All of it runs on one thread. Rows are interleaved and repeated; medians count.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from common import machine
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from uavrl.envs.bullet import STATIC, add_fixed, pybullet, silenced
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.world import World, WorldConfig
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.lidar.vlp16 import NUM_RAYS, firing_directions
from uavrl_onboard.mesh import Mesh

CUT, UNCUT = 4.0, 100.0
PYBULLET_BATCH = 16_000  # PyBullet takes fewer than 16,384 rays a call


def flight_poses(world: World, num: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions ``[N, 3]`` and rotations ``[N, 3, 3]`` of UAVs at the starts of random tasks."""
    rng = np.random.default_rng(0)
    positions = np.stack([world.sample_task(rng).start for _ in range(num)])
    angles = np.column_stack([rng.uniform(-0.2, 0.2, (num, 2)), rng.uniform(-math.pi, math.pi, num)])
    quaternions = [pybullet.getQuaternionFromEuler(a.tolist()) for a in angles]
    rotations = np.stack([np.reshape(pybullet.getMatrixFromQuaternion(q), (3, 3)) for q in quaternions])
    return positions, rotations


def bare_embree(meshes: list[Mesh], origins: np.ndarray, directions: np.ndarray, reach: float) -> Callable[[], object]:
    """Returns one Embree call on contiguous ready-made ray arrays ``[M, 3]``."""
    scene, mesh = EmbreeScene(), Mesh.merge(meshes)
    TriangleMesh(scene, mesh.vertices, mesh.faces)
    lengths = np.empty(len(origins), np.float32)

    def cast() -> np.ndarray:
        lengths.fill(reach)  # Embree shortens them in place
        return scene.run(origins, directions, lengths, query="DISTANCE")

    return cast


def pybullet_rays(meshes: list[Mesh], origins: np.ndarray, directions: np.ndarray) -> Callable[[], object]:
    """Returns `rayTestBatch` calls, uncut, on one thread, on ready-made lists."""
    with silenced():
        client = pybullet.connect(pybullet.DIRECT)
    for mesh in meshes:
        body = add_fixed(client, mesh, STATIC)
        pybullet.setCollisionFilterGroupMask(body, -1, -1, -1, physicsClientId=client)  # rays meet it too
    starts, ends = origins.tolist(), (origins + UNCUT * directions).tolist()
    parts = [slice(i, i + PYBULLET_BATCH) for i in range(0, len(starts), PYBULLET_BATCH)]

    def cast() -> list:
        return [
            hit
            for part in parts
            for hit in pybullet.rayTestBatch(starts[part], ends[part], numThreads=1, physicsClientId=client)
        ]

    if not any(hit[0] >= 0 for hit in cast()):
        raise SystemExit("PyBullet's rays meet nothing: its row would say nothing.")
    return cast


def reduced(lidar: Lidar, positions: np.ndarray, rotations: np.ndarray) -> torch.Tensor:
    """A scan and its reduction."""
    return truncated_icosahedron(torch.from_numpy(lidar.scan(positions, rotations)))


def build_rows(num: int, num_pybullet: int) -> dict[str, tuple[Callable[[], object], int, int]]:
    """Returns for each row what to time, how many scans that is, and in how many rounds it takes part (1: all)."""
    world = World(WorldConfig())
    positions, rotations = flight_poses(world, num)
    directions = (firing_directions() @ rotations.transpose(0, 2, 1)).astype(np.float32).reshape(-1, 3)
    origins = np.repeat(positions.astype(np.float32), NUM_RAYS, axis=0)
    rows: dict[str, tuple[Callable[[], object], int, int]] = {}
    for name, reach in (("cut", CUT), ("uncut", UNCUT)):
        lidar = Lidar(world.meshes, None, LidarConfig(max_range=reach))
        rows[f"bare Embree, {name}"] = (bare_embree(world.meshes, origins, directions, reach), num, 1)
        rows[f"scan, {name}"] = (partial(lidar.scan, positions, rotations), num, 1)
        rows[f"scan + reduction, {name}"] = (partial(reduced, lidar, positions, rotations), num, 1)
    few = slice(0, num_pybullet * NUM_RAYS)
    rows["PyBullet rayTestBatch, uncut"] = (
        pybullet_rays(world.meshes, origins[few], directions[few]),
        num_pybullet,
        10,
    )
    assert torch.equal(rows["scan + reduction, cut"][0](), rows["scan + reduction, uncut"][0]())  # type: ignore[arg-type]
    return rows


def measure(rows: dict[str, tuple[Callable[[], object], int, int]], repeats: int) -> dict[str, float]:
    """Returns the median time of each row in milliseconds per scan."""
    times: dict[str, list[float]] = {name: [] for name in rows}
    for turn in range(-1, repeats):  # turn -1 warms up
        for name, (run, scans, every) in rows.items():
            if turn % every == 0 or turn == -1:
                begin = time.perf_counter()
                run()
                if turn >= 0:
                    times[name].append((time.perf_counter() - begin) / scans * 1e3)
    return {name: float(np.median(values)) for name, values in times.items()}


def main() -> None:
    """Measures, prints the table, and writes the JSON file if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--num", type=int, default=8, help="UAVs per call")
    parser.add_argument("--num-pybullet", type=int, default=2, help="UAVs in PyBullet's row")
    parser.add_argument("--repeats", type=int, default=50, help="rounds; PyBullet takes part in every tenth")
    args = parser.parse_args()
    about = machine()
    torch.set_num_threads(1)
    milliseconds = measure(build_rows(args.num, min(args.num, args.num_pybullet)), args.repeats)
    ours = milliseconds["scan + reduction, cut"]
    ratios = {
        "vs_pybullet": milliseconds["PyBullet rayTestBatch, uncut"] / ours,
        "vs_bare_embree": ours / milliseconds["bare Embree, cut"],
    }
    print(f"{args.num} UAVs per call, {NUM_RAYS} rays per scan, one thread, median of {args.repeats} rounds\n")
    print(f"{'':32}{'ms per scan':>12}{'million rays/s':>16}")
    for name, value in milliseconds.items():
        print(f"{name:32}{value:12.3f}{NUM_RAYS / value / 1e3:16.2f}")
    print(f"\nscan + reduction, cut: {ratios['vs_pybullet']:.0f} times as fast as PyBullet's rays alone (goal: 40)")
    print(f"scan + reduction, cut: {ratios['vs_bare_embree']:.2f} times bare Embree's time (goal: at most 1.5)")
    if args.json:
        rows = {name: {"ms_per_scan": v, "rays_per_s": NUM_RAYS / v * 1e3} for name, v in milliseconds.items()}
        result = {**ratios, "num": args.num, "rays_per_scan": NUM_RAYS, "threads": 1, "rows": rows}
        result["machine"] = about
        args.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
