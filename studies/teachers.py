"""Which policies leave dead ends, and what does it cost in dense valleys? Draws each policy, and its teacher.

Run `python studies/teachers.py docs/img/teachers.png`. It reads docs/data/suite/teachers.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from pictures import save

from uavrl_onboard.cli.process import one_sentence

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "docs/data/suite/teachers.json"
ROWS = ("dense", "traps")


class Kind(NamedTuple):
    """Policies that clone one teacher in one way."""

    label: str
    colour: str
    marker: str
    names: tuple[str, ...]


def seeds(name: str, *numbers: int) -> tuple[str, ...]:
    """The names of the entries of several seeds."""
    return tuple(name if number == 0 else f"{name}, seed {number}" for number in numbers)


PLAIN, MEMORY = "three observations", "three observations and a GRU"
LONG = f"clones vfh_mapped_traps, {MEMORY}, 60,000 steps in 64 valleys"
KINDS = (
    Kind("vfh_headway", "tab:grey", "o", (f"clones vfh_headway, {PLAIN}",)),
    Kind("vfh_headway, memory", "tab:grey", "s", (f"clones vfh_headway, {MEMORY}",)),
    Kind("vfh_mapped", "tab:blue", "o", seeds(f"clones vfh_mapped, {PLAIN}", 0, 1, 2)),
    Kind("vfh_mapped, memory", "tab:blue", "s", seeds(f"clones vfh_mapped, {MEMORY}", 0, 1)),
    Kind("vfh_mapped_traps", "tab:red", "o", (f"clones vfh_mapped_traps, {PLAIN}",)),
    Kind("vfh_mapped_traps, memory", "tab:red", "s", seeds(f"clones vfh_mapped_traps, {MEMORY}", 0, 1, 2)),
    Kind("the same, 60,000 steps", "tab:red", "D", seeds(LONG, 0, 1)),
    Kind("vfh_privileged", "tab:green", "o", (f"clones vfh_privileged, {PLAIN}",)),
    Kind("vfh_privileged, memory", "tab:green", "s", (f"clones vfh_privileged, {MEMORY}",)),
)
TEACHERS = (("vfh_mapped", "tab:blue"), ("vfh_privileged", "tab:green"))


def rates(entry: dict[str, Any]) -> list[float]:
    """Success in % in the two rows."""
    return [100 * entry[row]["success"]["rate"] for row in ROWS]


def plot(entries: dict[str, Any], output: Path) -> None:
    """Draws success in dead ends over success in dense valleys: a mark for each seed, and stars for teachers."""
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    axes = figure.subplots()
    for kind in KINDS:
        found = [rates(entries[name]) for name in kind.names]
        across, up = zip(*found, strict=True)
        inside = "none" if kind.marker == "o" else kind.colour
        axes.scatter(across, up, 45, marker=kind.marker, edgecolors=kind.colour, facecolors=inside, label=kind.label)
    for name, colour in TEACHERS:
        dense, traps = rates(entries[name])
        axes.scatter(dense, traps, 110, marker="*", color=colour, label=f"{name}, the teacher")
    axes.set(xlabel="success in dense [%]", ylabel="success in traps [%]", xlim=(25, 103), ylim=(0, 104))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize="small", title="the policy clones")
    save(figure, output)


def main() -> None:
    """Draws all policies."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path, metavar="PNG", help="where the figure goes")
    plot(json.loads(DATA.read_text(encoding="utf-8")), parser.parse_args().output)


if __name__ == "__main__":
    with one_sentence():
        main()
