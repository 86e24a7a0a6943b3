"""Prints each result of the thesis beside those of our runs, and draws our learning curves against two of its rates.

    python studies/thesis.py --page docs/thesis.md
    python studies/thesis.py --plot docs/img/thesis.png

The thesis's numbers are in uavrl/reporting/thesis.json, and its author's walker in docs/data/bipedal/reference.json.
Rates are of training episodes. With five seeds or more a rate is their interquartile mean, with a 95 % bootstrap
interval over the seeds. With fewer it is that of each seed, with Wilson's interval over its episodes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from pictures import save
from run_statistics import FEWEST, RESAMPLES, Flights, cut, iqm, opened

from uavrl.errors import UavrlError
from uavrl.reporting.learning_curves import moving_mean
from uavrl.runs.episodes import read_episodes, wilson
from uavrl_onboard.cli.process import one_sentence

ROOT = Path(__file__).resolve().parents[1]
METHODS, WALKERS = ROOT / "docs/data/methods", ROOT / "docs/data/bipedal"
PRINTED = json.loads((ROOT / "uavrl/reporting/thesis.json").read_text(encoding="utf-8"))
WINDOW, LAST = PRINTED["window"], 200
NAMES = {"ddpg": "DDPG", "td3": "TD3", "td3_fork": "TD3-FORK", "td3_lg": "TD3-LG"}
THESIS, BACKWARD, OLDER = "thesis.json.gz", "backward.json.gz", "first_policies.json.gz"
FIGURE_4_4 = "Eq. 3.6 with its absolute value, ABR+, folded, experiment=figure_4_4"
LEARNERS, FULL = "learners.json", "default_5000.json"


class Row(NamedTuple):
    """A result of the thesis, or none, and the runs of ours beside it."""

    learner: str
    reward: str | None
    ours: str
    file: str = ""
    method: str = ""
    env: str = "static"


LETTER = (
    Row("ddpg", "TR", "TR", THESIS, "TR, DDPG"),
    Row("td3", "TR", "TR", THESIS, "TR"),
    Row("td3_fork", "TR", "TR", THESIS, "TR, TD3-FORK"),
    Row("td3_lg", "TR", "TR", THESIS, "TR, TD3-LG"),
    Row("td3", "ABR", "ABR", THESIS, "Eq. 3.6, ABR"),
    Row("td3", "ABR⁺", "no run"),
    Row("ddpg", "ABR⁺", "ABR", THESIS, "Eq. 3.6, ABR, DDPG"),
    Row("td3_fork", "ABR⁺", "ABR", THESIS, "Eq. 3.6, ABR, TD3-FORK"),
    Row("td3_lg", "ABR⁺", "ABR", THESIS, "Eq. 3.6, ABR, TD3-LG"),
    Row("td3", None, "ABR, -10 for a collision", THESIS, "Eq. 3.6, ABR, a collision at -10"),
)
SCALED = (
    Row("td3", "TR", "TR, angles / 360", THESIS, "TR, /360"),
    Row("td3", "TR", "TR, folded angles", BACKWARD, "TR"),
    Row("td3", "TR", "TR, folded angles, older code", OLDER, "TR"),
    Row("td3", "TR", "TR, folded angles, `experiment=figure_4_4`", THESIS, "TR, folded, experiment=figure_4_4"),
    Row("td3_lg", "TR", "TR, folded angles", BACKWARD, "TR, LifeGuard linear"),
    Row("td3", "ABR", "ABR, Eq. 3.6 as printed, angles / 360", THESIS, "Eq. 3.6, ABR, /360"),
    Row("td3", "ABR", "ABR, Eq. 3.6 as printed, folded angles", THESIS, "Eq. 3.6, ABR, folded"),
    Row("td3", "ABR", "ABR, folded angles", THESIS, "Eq. 3.6 with its absolute value, ABR, folded"),
    Row("td3", "ABR⁺", "ABR⁺, folded angles, `experiment=figure_4_4`", THESIS, FIGURE_4_4),
    Row("td3", None, "Eq. 3.6 as printed, angles / 360", THESIS, "Eq. 3.6, /360"),
)
BONUS = (
    Row("td3", "ABR", "ABR and the bonus", BACKWARD, "ABR, growing ranks"),
    Row("td3", "ABR", "ABR and the bonus, older code", OLDER, "default reward, ABR"),
    Row("td3", "ABR⁺", "ABR⁺ and the bonus", BACKWARD, "ABR⁺, growing ranks"),
    Row("ddpg", "ABR⁺", "the bonus", LEARNERS, "DDPG"),
    Row("td3", "ABR⁺", "the bonus", BACKWARD, "default reward"),
    Row("td3", "ABR⁺", "the bonus, older code", OLDER, "default reward"),
    Row("td3", "ABR⁺", "the bonus", FULL, "default"),
    Row("td3_fork", "ABR⁺", "the bonus", LEARNERS, "TD3-FORK"),
    Row("td3_lg", "ABR⁺", "the bonus, -50 for a collision", LEARNERS, "TD3-LG"),
)
AEROPLANES = (
    Row("td3", "TR", "TR", THESIS, "TR, dynamic", "dynamic"),
    Row("td3", "ABR", "ABR", THESIS, "Eq. 3.6, ABR, dynamic", "dynamic"),
    Row("td3", "ABR⁺", "no run", env="dynamic"),
    Row("td3_fork", "ABR⁺", "no run", env="dynamic"),
    Row("td3_lg", "ABR⁺", "ABR", THESIS, "Eq. 3.6, ABR, TD3-LG, dynamic", "dynamic"),
    Row("td3_lg", None, "TR", THESIS, "TR, TD3-LG, dynamic", "dynamic"),
)
SAMPLES = (
    Row("td3_fork", "ABR⁺", "ABR, `preset=thesis`", THESIS, "Eq. 3.6, ABR, TD3-FORK"),
    Row("td3_fork", "ABR⁺", "the bonus", LEARNERS, "TD3-FORK"),
    Row("td3_lg", "ABR⁺", "ABR, `preset=thesis`", THESIS, "Eq. 3.6, ABR, TD3-LG"),
    Row("td3_lg", "ABR⁺", "the bonus, -50 for a collision", LEARNERS, "TD3-LG"),
)
CURVES = (  # what is drawn, in this order
    ("TR, 0 to 360", "C3", THESIS, "TR"),
    ("ABR, 0 to 360", "C0", THESIS, "Eq. 3.6, ABR"),
    ("TR, angles / 360", "C1", THESIS, "TR, /360"),
    ("ABR, angles / 360", "C9", THESIS, "Eq. 3.6, ABR, /360"),
    ("TR, folded", "C5", OLDER, "TR"),
    ("ABR, folded", "C4", THESIS, "Eq. 3.6 with its absolute value, ABR, folded"),
    ("ABR⁺, folded", "C6", THESIS, FIGURE_4_4),
    ("ABR and bonus, folded", "C2", OLDER, "default reward, ABR"),
    ("bonus, folded", "0.3", FULL, "default"),
)


def kept(file: str, method: str) -> list[tuple[int, Flights]]:
    """The seed and the episodes of each run of a method."""
    with opened(METHODS / file, "rt") as text:
        return [(run["seed"], cut(run, None, None)) for run in json.load(text)[method]]


def rate(runs: Sequence[Flights], end: str, window: int, *, interval: bool = False) -> str:
    """The share of the last episodes that ended so, in %."""
    shares = np.array([run.share(end, window) for run in runs])
    if len(runs) >= FEWEST:
        drawn = iqm(np.random.default_rng(0).choice(shares, (RESAMPLES, len(shares))))
        low, high = np.quantile(drawn, [0.025, 0.975])
        return f"{iqm(shares):.1f}" + (f" ({low:.1f}–{high:.1f})" if interval else "")
    if not interval:
        return ", ".join(f"{share:.1f}" for share in shares)
    found = [wilson(int((run.ends[-window:] == end).sum()), window) for run in runs]
    return ", ".join("{:.1f} ({:.1f}–{:.1f})".format(*(100 * f[key] for key in ("rate", "low", "high"))) for f in found)


def lengths(runs: Sequence[Flights]) -> str:
    """Episodes of each run, and its steps in thousands; with five runs or more the range and the mean."""
    counts = [(len(run.steps), round(run.steps.sum() / 1000)) for run in runs]
    if len(runs) < FEWEST:
        return ", ".join(f"{episodes:,} ({steps:,}k)" for episodes, steps in counts)
    episodes, steps = zip(*counts, strict=True)
    return f"{min(episodes):,}–{max(episodes):,} ({round(np.mean(steps)):,}k)"


def rates_of(learner: str, reward: str, env: str = "static") -> dict[str, Any]:
    """The thesis's rates."""
    return next(r for r in PRINTED["rates"] if (r["env"], r["learner"], r["reward"]) == (env, learner, reward))


def printed(row: Row) -> tuple[str, str]:
    """The thesis's learner and reward, and its success, collision and time-out rates."""
    if row.reward is None:
        return f"none ({NAMES[row.learner]})", "–"
    found = rates_of(row.learner, row.reward, row.env)
    success, collision = found["success"], found["collision"]
    rest = ["–", "–"] if collision is None else [f"{100 * x:.1f}" for x in (collision, 1 - success - collision)]
    return f"{NAMES[row.learner]}, {row.reward}", f"**{100 * success:.1f}**, {', '.join(rest)}"


def seeds(found: Sequence[tuple[int, Any]]) -> str:
    """Which seeds."""
    numbers = [seed for seed, _ in found]
    return f"{numbers[0]}–{numbers[-1]}" if len(numbers) > 2 else ", ".join(map(str, numbers))


def rates(rows: Sequence[Row]) -> list[str]:
    """A table of rates."""
    lines = [
        f"| thesis: learner, reward | its success, collision, time-out in % | ours | seeds | episodes (steps) of ours "
        f"| success in %, last {WINDOW} | collision in % | time-out in % | success in %, last {LAST} |",
        "|---" * 9 + "|",
    ]
    for row in rows:
        cells = [*printed(row), row.ours, *(_cells(row) if row.method else "–" * 6)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _cells(row: Row) -> list[str]:
    found = kept(row.file, row.method)
    runs = [run for _, run in found]
    shares = [rate(runs, end, window) for end, window in (("c", WINDOW), ("t", WINDOW), ("a", LAST))]
    return [seeds(found), lengths(runs), rate(runs, "a", WINDOW, interval=True), *shares]


def samples() -> list[str]:
    """Table 4.2: steps to a success rate."""
    lines = ["| thesis | its steps | ours | seeds | our steps to the same rate |", "|---" * 5 + "|"]
    for found in PRINTED["steps_to"]:
        ours = [row for row in SAMPLES if found["env"] == "static" and row.learner == found["learner"]]
        name = f"{NAMES[found['learner']]}, {found['reward']}, {found['env']}, {100 * found['threshold']:.0f} %"
        for row in ours:
            runs = kept(row.file, row.method)
            reached = [(run.until(found["threshold"], WINDOW), run.steps.sum()) for _, run in runs]
            told = [
                f"{steps:,.0f}k" if np.isfinite(steps) else f"not within {total / 1000:,.0f}k"
                for steps, total in reached
            ]
            lines.append(f"| {name} | {found['steps']:,} | {row.ours} | {seeds(runs)} | {', '.join(told)} |")
        if not ours:
            lines.append(f"| {name} | {found['steps']:,} | no run | – | – |")
    return lines


def classes() -> list[str]:
    """Figure 4.2: sizes of the classes."""
    artifact = ROOT / "uavrl/artifacts/abr_plus_static/artifact.json"
    ours = json.loads(artifact.read_text(encoding="utf-8"))["class_sizes"]
    shot, siamese = (row["sd"] for row in PRINTED["class_sizes"])
    ordered = {"PSAE and k-means, k = 4000": siamese, "PSAE and k-means, k = 1000": None, "one-shot learning": shot}
    lines = ["| classes | SD of class sizes in the thesis | ours | number of our classes |", "|---|---|---|---|"]
    for name, theirs in ordered.items():
        told = "–" if theirs is None else f"{theirs:,.2f}"
        lines.append(f"| {name} | {told} | {ours[name]['sd']:,.2f} | {ours[name]['classes']:,} |")
    return lines


def walkers() -> list[str]:
    """Figure 4.6: mean return of the last 100 episodes of each curve."""
    published = json.loads((WALKERS / "reference.json").read_text(encoding="utf-8"))
    curves = {
        "TD3-LG, published by the thesis's author": published["td3_lg"]["episode_return"],
        "TD3-LG, ours": _returns("td3_lg_seed0"),
        "TD3-FORK, published by FORK's authors": published["td3_fork"]["episode_return"],
        "TD3-FORK, ours": _returns("td3_fork_seed0"),
    }
    lines = [
        "| run, one seed each | episodes | mean return after 1,000 episodes | at its end | first above 250 |",
        "|---" * 5 + "|",
    ]
    for name, returns in curves.items():
        means = moving_mean(returns, 100)
        above = np.flatnonzero(means[99:] > 250)
        first = f"episode {above[0] + 100:,}" if len(above) else "not reached"
        lines.append(f"| {name} | {len(returns):,} | {means[999]:.0f} | {means[-1]:.0f} | {first} |")
    return lines


def _returns(run: str) -> list[float]:
    return [episode.episode_return for episode in read_episodes(WALKERS / run / "episodes.csv")]


TABLES: dict[str, Callable[[], list[str]]] = {
    "letter": lambda: rates(LETTER),
    "scaled angles": lambda: rates(SCALED),
    "bonus": lambda: rates(BONUS),
    "aeroplanes": lambda: rates(AEROPLANES),
    "sample complexity": samples,
    "class sizes": classes,
    "walkers": walkers,
}


def marks(name: str) -> tuple[str, str]:
    """The comments around a table in the page."""
    return f"<!-- {name}: studies/thesis.py -->\n", f"<!-- end of {name} -->\n"


def plot(output: Path) -> None:
    """Draws the success rate of TD3's runs over episodes, a line for each seed, and the thesis's last rates."""
    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.subplots()
    for label, colour, file, method in CURVES:
        for number, (_, run) in enumerate(kept(file, method)):
            rates = 100 * moving_mean(run.ends == "a", WINDOW)[WINDOW - 1 :]
            episodes = np.arange(WINDOW, WINDOW + len(rates))
            axes.plot(episodes, rates, color=colour, linewidth=1.5, label=None if number else label)
    for reward, style in (("ABR⁺", "--"), ("TR", ":")):
        last = 100 * rates_of("td3", reward)["success"]
        axes.axhline(last, color="k", linestyle=style, linewidth=1.2, label=f"thesis, at its end: {reward}")
    axes.set(xlabel="training episodes", ylabel=f"success, last {WINDOW} episodes [%]", ylim=(-2, 100), xlim=(0, 5050))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize="small")
    save(figure, output)


def main() -> None:
    """Prints the tables, or puts them into a page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--page", type=Path, help="put the tables between the comments of this page")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="draw the learning curves")
    args = parser.parse_args()
    if args.plot:
        plot(args.plot)
    text = args.page.read_text(encoding="utf-8") if args.page else None
    for name, table in TABLES.items():
        lines = "\n".join([*table(), ""])
        if text is None:
            print(f"{name}\n{lines}")
            continue
        begin, end = marks(name)
        if begin not in text or end not in text:
            raise UavrlError(f"Expected the comments {begin.strip()} and {end.strip()} in {args.page}.")
        text = f"{text.partition(begin)[0]}{begin}{lines}{end}{text.partition(end)[2]}"
    if args.page and text is not None:
        args.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
