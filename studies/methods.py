"""Which method is better: seeds of several methods side by side, as rliable does it.

    python studies/methods.py FILE.json [--add METHOD=RUN_FOLDER ...] [--baseline METHOD] [--flights 1500] ...

`--add` puts runs into FILE.json: each run's settings that differ from the default's, its commit, and how each flight
ended after how many steps. The tables are made from that file alone, so that whoever has it can make them again.
`--pool NAME=METHOD NAME=METHOD` shows the runs of several methods as one more row.

For each method: of five seeds or more the interquartile mean (the mean of the middle half; the median where a run never
came so far) and the lowest and highest seed; of fewer each seed's, in the order of the seeds. Against the baseline: the
difference of the interquartile means, with a 95 % interval by resampling seeds (Agarwal et al. 2021, arXiv:2108.13264).
With fewer than five seeds of either no interval is given: of so few it would be much too narrow.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure
from omegaconf import OmegaConf
from run_statistics import FEWEST, Flights, cut, difference, iqm, named_folder, opened
from torchrl.checkpoint import Checkpoint

from uavrl.config import compose
from uavrl.errors import UavrlError
from uavrl.reporting.groups import below
from uavrl.reporting.learning_curves import moving_mean
from uavrl.reporting.runs import flatten
from uavrl.runs.config import HOW_IT_RUNS
from uavrl.runs.episodes import OUTCOMES, read_episodes
from uavrl.runs.names import ANY_CHECKPOINT
from uavrl_onboard.cli.process import one_sentence

LETTERS = {outcome: outcome[0] for outcome in OUTCOMES}


def measures(window: int, success: float) -> dict[str, Callable[[Flights], float]]:
    """What is told of a run."""
    return {
        "arrived, last": lambda run: run.share("a", window),
        "arrived, all": lambda run: run.share("a"),
        f"k steps to {success:.0%}": lambda run: run.until(success, window),
        "collided, all": lambda run: run.share("c"),
        "timed out, last": lambda run: run.share("t", window),
        "steps an arrival": lambda run: run.steps_per_arrival(window),
    }


def read(run: Path) -> dict[str, Any]:
    """What is kept of a run."""
    here, there = (_flat(config) for config in (OmegaConf.load(run / "config.yaml"), compose()))
    episodes = read_episodes(run / "episodes.csv")
    return {
        "seed": int(here.pop("seed")),
        "commit": _commit(run),
        "settings": {key: value for key, value in here.items() if value != there.get(key)},
        "ends": "".join(LETTERS[episode.outcome] for episode in episodes),
        "steps": [episode.steps for episode in episodes],
    }


def _commit(run: Path) -> str | None:
    """What a run was flown with: its summary tells, or the last checkpoint of one that was stopped."""
    if (summary := run / "summary.json").is_file():
        return json.loads(summary.read_text(encoding="utf-8"))["versions"].get("commit")
    checkpoints = sorted(run.glob(ANY_CHECKPOINT))
    return Checkpoint.manifest(checkpoints[-1])["metadata"].get("commit") if checkpoints else None


def _flat(config: Any) -> dict[str, Any]:
    """The values that bear on what is learned, by dotted names."""
    values = flatten(cast(dict[str, Any], OmegaConf.to_container(config, resolve=True)))
    return {
        key: value for key, value in values.items() if not below(key, ("trainer.checkpoint_interval", *HOW_IT_RUNS))
    }


def told(runs: dict[str, list[Flights]], args: argparse.Namespace) -> dict[str, Any]:
    """The numbers of the table."""
    asked = measures(args.window, args.success)
    values = {
        name: {key: np.array([ask(run) for run in seeds]) for key, ask in asked.items()} for name, seeds in runs.items()
    }
    result: dict[str, Any] = {}
    for name, found in values.items():
        result[name] = {"seeds": len(runs[name]), "measures": {}}
        for key, each in found.items():
            row: dict[str, Any] = {"iqm": float(iqm(each)), "seeds": each.tolist()}
            base = values.get(args.baseline, {}).get(key)
            if base is not None and name != args.baseline and min(len(each), len(base)) >= FEWEST:
                row["difference"] = difference(each, base) if np.isfinite([*each, *base]).all() else None
            result[name]["measures"][key] = row
    return result


def shown(row: dict[str, Any]) -> str:
    """A cell: the mean, and between which seeds it lies; of few seeds what each has."""
    seeds = row["seeds"]
    if len(seeds) < FEWEST:
        return ", ".join(map(_number, seeds))
    if np.isnan(row["iqm"]):
        return "–"
    return f"{_number(row['iqm'])} ({_number(min(seeds))}–{_number(max(seeds))})"


def _number(value: float) -> str:
    if np.isnan(value):
        return "–"
    return "never" if np.isinf(value) else f"{value:.1f}"


def table(result: dict[str, Any], baseline: str | None) -> str:
    """As markdown."""
    keys = list(next(iter(result.values()))["measures"])
    lines = [f"| method | seeds | {' | '.join(keys)} |", "|---" * (len(keys) + 2) + "|"]
    for name, row in result.items():
        lines.append(f"| {name} | {row['seeds']} | {' | '.join(shown(row['measures'][key]) for key in keys)} |")
    for name, row in result.items():
        for key in keys:
            if "difference" not in row["measures"][key]:
                continue
            found = row["measures"][key]["difference"]
            told = (
                f"{found[0]:+.1f} ({found[1]:+.1f} to {found[2]:+.1f})"
                if found
                else "no interval, one never came so far"
            )
            lines.append(f"{name} against {baseline}, {key}: {told}")
    return "\n".join(lines)


def plot(runs: dict[str, list[Flights]], window: int, output: Path) -> None:
    """Draws how often each method arrived in the last ``window`` flights: thin a seed, thick their median."""
    fewest = min(len(seed.ends) for seeds in runs.values() for seed in seeds)
    if fewest < window:
        raise UavrlError(f"A run flew {fewest} flights, fewer than --window {window}: draw with a smaller one.")
    figure = Figure(figsize=(7, 3.8), layout="constrained")
    axes = figure.subplots()
    for number, (name, seeds) in enumerate(runs.items()):
        colour = f"C{number}"
        curves = [
            (seed.steps.cumsum()[window - 1 :] / 1000, 100 * moving_mean(seed.ends == "a", window)[window - 1 :])
            for seed in seeds
        ]
        for steps, rates in curves:
            axes.plot(steps, rates, color=colour, linewidth=0.7, alpha=0.6)
        shared = np.linspace(max(steps[0] for steps, _ in curves), min(steps[-1] for steps, _ in curves), 200)
        median = np.median([np.interp(shared, steps, rates) for steps, rates in curves], axis=0)
        axes.plot(shared, median, color=colour, linewidth=2.2, label=f"{name} ({len(seeds)})")
    axes.set(xlabel="environment steps [thousand]", ylabel=f"success, last {window} episodes [%]", ylim=(0, 100))
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize="small")
    figure.savefig(output, dpi=120)


def main() -> None:
    """Adds runs, and prints the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", type=Path, help="where the runs are kept")
    parser.add_argument(
        "--add", nargs="+", action="extend", default=[], metavar="METHOD=RUN_FOLDER", help="put runs into the file"
    )
    parser.add_argument("--baseline", help="the method that others are compared with")
    parser.add_argument("--methods", nargs="+", action="extend", help="only these")
    parser.add_argument(
        "--pool", nargs="+", action="extend", default=[], metavar="NAME=METHOD", help="a row of several methods' runs"
    )
    parser.add_argument("--flights", type=int, help="flights of each run that count (default: all)")
    parser.add_argument("--steps", type=int, help="steps of each run that count (default: all)")
    parser.add_argument("--window", type=int, default=250, help="flights that a rate at the end covers")
    parser.add_argument("--success", type=float, default=0.8, help="share of arrivals whose steps are told")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="also draw arrivals over steps")
    args = parser.parse_args()
    kept: dict[str, list[dict[str, Any]]] = {}
    if args.file.is_file():
        with opened(args.file, "rt") as file:
            kept = json.load(file)
    for pair in args.add:
        method, folder = named_folder(pair)
        run = read(folder)
        others = [other for other in kept.get(method, []) if other["seed"] != run["seed"]]
        kept[method] = sorted([*others, run], key=lambda one: one["seed"])
    if args.add:
        lines = ",\n".join(f"{json.dumps(name)}: [\n{_rows(seeds)}\n]" for name, seeds in kept.items())
        args.file.parent.mkdir(parents=True, exist_ok=True)
        with opened(args.file, "wt") as file:
            file.write(f"{{\n{lines}\n}}\n")
    pools: dict[str, list[dict[str, Any]]] = {}
    for pair in args.pool:
        name, sign, method = pair.partition("=")
        if not sign or name in kept:
            raise UavrlError(f"Expected NAME=METHOD with a name that is no method's, got {pair!r}.")
        pools.setdefault(name, []).extend(_runs(kept, method))
    names = [*(args.methods or kept), *pools]
    kept |= pools
    if args.baseline is not None and args.baseline not in names:
        raise UavrlError(f"The baseline must be one of {'; '.join(names)}, got {args.baseline!r}.")
    runs = {name: [cut(run, args.flights, args.steps) for run in _runs(kept, name)] for name in names}
    result = told(runs, args)
    print(table(result, args.baseline))
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if args.plot:
        plot(runs, args.window, args.plot)


def _runs(kept: dict[str, list[dict[str, Any]]], method: str) -> list[dict[str, Any]]:
    if method not in kept:
        raise UavrlError(f"Expected one of the methods {'; '.join(kept)}, got {method!r}.")
    return kept[method]


def _rows(seeds: list[dict[str, Any]]) -> str:
    return ",\n".join(json.dumps(run, separators=(",", ":")) for run in seeds)


if __name__ == "__main__":
    with one_sentence():
        main()
