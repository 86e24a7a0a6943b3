"""How well do the rays of the simulated Mid-360 lie as those of real ones?

Run `python studies/mid360_pattern.py livox_pointcloud_sample_1.json 20240509061326.pcd 20240509061328.pcd`. The files
are of kompass-core (`tests/resources/mapping`) and of QuintinUmi/mid360_hikcamera_calibration
(`src/livox_hikcamera_cal/pcd`): one scan each, in firing order, with zeros where nothing was hit. Each is laid beside
the moment of the pattern that fits it best. The gap is the angle from a random direction in the field of view to the
nearest return, and to the nearest of as many rays of the model.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from uavrl.envs.sensors import SENSORS
from uavrl_onboard.cli.process import one_sentence

STEP = 25  # rays between two moments that are tried: any of the four beams may come first
SHARES = (0.5, 0.9, 0.99)
INSIDE = (-6.0, 51.0)  # degrees, within the field of view


def scan_of(path: Path) -> np.ndarray:
    """The points ``[P, 3]`` of a file in firing order, with zeros for misses."""
    if path.suffix == ".json":
        message = json.loads(path.read_text(encoding="utf-8"))
        offsets = {each["name"]: each["offset"] for each in message["fields"]}
        layout = {"names": list("xyz"), "formats": ["<f4"] * 3, "offsets": [offsets[axis] for axis in "xyz"]}
        raw = np.array(message["data"], np.uint8).view(np.dtype(layout | {"itemsize": message["point_step"]}))  # type: ignore[call-overload]
        return np.stack([raw[axis] for axis in "xyz"], -1).astype(float)
    _, _, rows = path.read_text(encoding="ascii").partition("DATA ascii\n")
    return np.array(rows.split(), float).reshape(-1, 4)[:, :3]


def elevations(directions: np.ndarray) -> np.ndarray:
    """Degrees."""
    return np.degrees(np.arctan2(directions[..., 2], np.hypot(directions[..., 0], directions[..., 1])))


def compared(points: np.ndarray, rng: np.random.Generator) -> tuple[float, list[float], list[float]]:
    """How far elevations are off in degrees (root of the mean square), and the gaps of returns and of the model."""
    rays = SENSORS["mid360"].rays.directions.astype(float).reshape(-1, 3)
    hit = np.flatnonzero(points.any(-1))
    real = points[hit] / np.linalg.norm(points[hit], axis=-1, keepdims=True)
    starts = range(0, len(rays) - len(points), STEP)
    off = [float(np.square(elevations(rays[hit + start]) - elevations(real)).mean()) for start in starts]
    model = rays[starts[int(np.argmin(off))] :][: len(points)]
    somewhere = rng.normal(size=(40_000, 3))
    somewhere = somewhere[(elevations(somewhere) > INSIDE[0]) & (elevations(somewhere) < INSIDE[1])]
    somewhere /= np.linalg.norm(somewhere, axis=-1, keepdims=True)
    gaps = []
    for seen in (real, rng.permutation(model)[: len(real)]):
        away = np.degrees(2 * np.arcsin(cKDTree(seen).query(somewhere)[0] / 2))
        gaps.append([float(each) for each in np.quantile(away, SHARES)])
    return min(off) ** 0.5, gaps[0], gaps[1]


def main(words: Sequence[str] | None = None) -> None:
    """Prints a row for each file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    args = parser.parse_args(words)
    rng = np.random.default_rng(0)
    shares = ", ".join(f"{share:.0%}" for share in SHARES)
    print(f"| scan | returns | elevations off, ° | gaps of the scan, ° ({shares}) | gaps of the model, ° |")
    print("|---|---|---|---|---|")
    for path in args.files:
        points = scan_of(path)
        off, real, model = compared(points, rng)
        told = (", ".join(f"{each:.2f}" for each in gaps) for gaps in (real, model))
        print(f"| {path.name} | {int(points.any(-1).sum()):,} | {off:.2f} | {' | '.join(told)} |", flush=True)


if __name__ == "__main__":
    with one_sentence():
        main()
