"""How do policies fail? Draws the first failure in each of some recordings from above, side by side.

    for name in vfh_star mppi potential_field best; do
        uavrl-replay policy=$name env=static valleys=training env.world.obstacles=90 episodes=12 data=$name.npz \
            output=$name.html
    done
    uavrl-replay policy=rrt_connect valleys=training env.world.obstacles=135 episodes=12 data=rrt_connect.npz \
            output=rrt_connect.html
    uavrl-replay policy=rrt_map valleys=training env.world.obstacles=135 tasks=[21,47,64] data=rrt_map.npz \
            output=rrt_map.html
    python studies/failures.py {vfh_star,mppi,potential_field,rrt_connect,rrt_map,best}.npz --output failures.png

Dark is what is higher than 1.5 m below the place where the flight ends; light is what is lower. The way turns
from blue to yellow with time, has a dot each second and ends in a cross. The goal is a circle.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from uavrl.envs.navigation import CONTROL_RATE
from uavrl.errors import UavrlError
from uavrl.evaluation.recording import RecordedFlight, Scenery, load_recording
from uavrl.runs.episodes import OUTCOMES, SAID
from uavrl_onboard.cli.process import one_sentence

REACH = 1.5  # m below
ROUND = 2.5  # m, that is drawn around a way


def draw(axes: Axes, flight: RecordedFlight, scenery: Scenery) -> None:
    """One flight from above."""
    way, height = flight.positions, flight.positions[-1, 2]
    corners = scenery.vertices[scenery.triangles]
    tall = corners[..., 2].max(1) >= height - REACH
    for which, colour in ((~tall, "0.88"), (tall, "0.45")):
        axes.add_collection(PolyCollection(corners[which, :, :2], facecolors=colour, edgecolors="none"))
    axes.scatter(*way[:, :2].T, c=flight.times, s=3, cmap="viridis")
    seconds = way[:: round(CONTROL_RATE)]
    axes.scatter(*seconds[:, :2].T, c=flight.times[:: round(CONTROL_RATE)], s=14, cmap="viridis")
    axes.plot(*way[-1, :2], "x", color="crimson", markersize=9, markeredgewidth=2)
    angle = np.linspace(0, 2 * np.pi, 60)
    axes.plot(*(flight.goal[:2, None] + scenery.goal[0] * np.stack([np.cos(angle), np.sin(angle)])), color="green")
    shown = np.concatenate([way[:, :2], flight.goal[None, :2]])
    middle, half = (shown.min(0) + shown.max(0)) / 2, np.ptp(shown, axis=0).max() / 2 + ROUND
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")


def main() -> None:
    """Writes one picture and prints how each recording's flights ended."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", type=Path, nargs="+", help="files that uavrl-replay data=FILE wrote")
    parser.add_argument("--output", type=Path, required=True)
    args = parser.parse_args()
    failures = []
    for path in args.recordings:
        recording = load_recording(path)
        ends = [flight.summary.outcome for flight in recording.flights]
        print(f"{path.stem}: {', '.join(f'{SAID[kind]} {ends.count(kind)}' for kind in OUTCOMES if kind in ends)}")
        failed = [flight for flight in recording.flights if flight.summary.outcome != "arrived"]
        failures += [(path.stem, flight, recording.scenery(flight)) for flight in failed[:1]]
    if not failures:
        raise UavrlError("Every flight of these recordings succeeds: record more tasks, or harder ones.")
    figure = Figure(figsize=(3.4 * len(failures), 3.8), layout="constrained")
    for axes, (name, flight, scenery) in zip(
        figure.subplots(1, len(failures), squeeze=False)[0], failures, strict=True
    ):
        draw(axes, flight, scenery)
        about, lasted = flight.summary, flight.times[-1]
        ended = SAID[about.outcome]
        axes.set_title(f"{name}, task {about.task}: {ended} after {lasted:.1f} s", fontsize=8)
        axes.tick_params(labelsize=7)
    figure.savefig(args.output, dpi=85)
    Image.open(args.output).convert("RGB").quantize(128).save(args.output, optimize=True)


if __name__ == "__main__":
    with one_sentence():
        main()
