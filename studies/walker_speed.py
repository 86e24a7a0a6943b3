"""How fast a training of the bipedal walker goes, and where its time goes.

    PYTHONPATH=benchmarks:examples/walker python studies/walker_speed.py [--steps N] [--json FILE] [OVERRIDES]

It is `uavrl-train env=bipedal_hardcore learner=td3_lg_walker` through its real trainer, with 300 random steps; an
override is e.g. `trainer.execution=captured`. Episodes in the random steps and the first one after them, and with that
compilation, are left out.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from common import compose, machine
from profiling import Stopwatch

from uavrl_onboard.cli.process import one_sentence

RANDOM_STEPS, WARM_UP = 300, 100
EXAMPLE = Path(__file__).resolve().parents[1] / "examples/walker"


class EnoughError(Exception):
    """Ends a training that was measured for long enough."""


def measure(steps: int, overrides: list[str]) -> dict[str, Any]:
    """Steps per second and the share of each part, over whole episodes of at least ``steps`` in all."""
    from uavrl_onboard.cli.process import configure_logging

    configure_logging()
    from walker.env import BipedalEnv

    from uavrl.training import run
    from uavrl.training.trainer import EpisodeTrainer
    from uavrl.training.update import ActorCriticStepper

    watch = Stopwatch("collector, policy, bookkeeping")
    marks: list[tuple[int, float]] = []

    class Watched(run.Progress):
        def update(self, episodes: int, steps_done: int, *args: Any) -> None:
            if not marks and steps_done >= RANDOM_STEPS + WARM_UP:
                watch.reset()
            if steps_done >= RANDOM_STEPS + WARM_UP:
                marks.append((steps_done, time.perf_counter()))
            if marks and steps_done >= marks[0][0] + steps:
                raise EnoughError

    run.Progress = Watched  # type: ignore[misc]
    places: dict[str, list[tuple[Any, str]]] = {
        "environment": [(BipedalEnv, "_step"), (BipedalEnv, "_reset")],
        "LifeGuard's own training": [(ActorCriticStepper, "observe")],
        "updates": [(EpisodeTrainer, "learn")],
    }
    with tempfile.TemporaryDirectory() as folder, watch.watching(places):
        config = compose(
            "packages=[walker]",
            "env=bipedal_hardcore",
            "learner=td3_lg_walker",
            f"run_dir={folder}/run",
            f"algo.learning_starts={RANDOM_STEPS}",
            "trainer.progress=false",
            *overrides,
            own=[EXAMPLE / "conf"],
        )
        try:
            run.train(config, run.create_run(config))
        except EnoughError:
            seconds = watch.stop()
    walked, taken = marks[-1][0] - marks[0][0], marks[-1][1] - marks[0][1]
    shares = {part: value / sum(seconds.values()) for part, value in seconds.items()}
    return {"steps": walked, "steps_per_second": walked / taken, "shares": shares, **machine()}


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("overrides", nargs="*")
    args = parser.parse_args()
    result = measure(args.steps, args.overrides)
    print(f"{result['steps_per_second']:.1f} steps/s over {result['steps']:,} steps, load {result['load_before']:.1f}")
    for part, share in sorted(result["shares"].items(), key=lambda item: -item[1]):
        print(f"{share:>6.1%}  {part}")
    if args.json is not None:
        args.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
