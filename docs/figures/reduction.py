"""Draw one simulated scan and the 72 cells to which it is reduced.

python docs/figures/reduction.py --output docs/img/reduction.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavrl.envs import LidarConfig, NavigationEnv
from uavrl.transforms.range_image import VLP16_GRID, range_image

RADIUS = 4.0  # m, how far the cells look
RANGE = 30.0  # m, how far the drawn scan looks
NEAR_IS_BRIGHT = "viridis_r"


def scan(task: int) -> torch.Tensor:
    """Return the first scan of a task of seed 0 in the default valley: ``[P, 3]``, m, in the sensor's frame."""
    env = NavigationEnv(num_uavs=1, lidar=LidarConfig(max_range=RANGE))
    cloud: torch.Tensor = env.reset(task=task)["point_cloud"][0]
    env.close()
    return cloud[torch.isfinite(cloud).all(-1)]


def picture_of(cells: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the distances of cells as an image from left to right, with the column behind at both ends; NaN is empty.

    >>> picture_of(np.zeros(72, np.float32)).shape
    (3, 25)
    """
    distances = np.where(cells > 0, RADIUS - cells, np.nan).reshape(VLP16_GRID.columns, VLP16_GRID.rows)
    from_behind = np.roll(distances[::-1], VLP16_GRID.columns // 2 + 1, axis=0)
    return np.concatenate([from_behind, from_behind[:1]]).T


def main() -> None:
    """Draw the scan above its cells, with the same colours."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", type=int, default=17, help="number of the task")
    parser.add_argument("--output", type=Path, default=Path("reduction.png"))
    args = parser.parse_args()
    points = scan(args.task)
    cells = range_image(points, RADIUS).numpy()
    x, y, z = points.numpy().T
    distance = np.sqrt(x**2 + y**2 + z**2)
    near = distance <= RADIUS
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    figure = Figure(figsize=(9, 3.9), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    colours = Normalize(1.0, RADIUS)
    bars = {"marker": "|", "s": 42, "linewidths": 0.5}
    above.scatter(azimuth[~near], elevation[~near], color="0.8", **bars)
    above.scatter(azimuth[near], elevation[near], c=distance[near], cmap=NEAR_IS_BRIGHT, norm=colours, **bars)
    above.set(
        title="one scan of 28,928 rays (grey: farther than 4 m, white: no return)",
        ylabel="elevation [°]",
        ylim=(-16.5, 16.5),
    )
    half = 180.0 / VLP16_GRID.columns
    image = below.imshow(
        picture_of(cells),
        origin="lower",
        aspect="auto",
        cmap=NEAR_IS_BRIGHT,
        norm=colours,
        extent=(180.0 + half, -180.0 - half, 0.0, VLP16_GRID.rows),
    )
    below.set(
        title="what the policy receives: 72 cells (white: nothing within 4 m)", xlabel="azimuth [°], left positive"
    )
    below.set(yticks=[], xlim=(180, -180), xticks=range(180, -181, -60))
    figure.colorbar(image, ax=[above, below], label="distance [m]")
    figure.savefig(args.output, dpi=110)
    seen = f"{near.sum()} returns within {RADIUS:.0f} m, {(cells > 0).sum()} of {cells.size} cells"
    print(f"{seen}: drawn to {args.output}")


if __name__ == "__main__":
    main()
