"""One HTML page from a report's facts: it fetches nothing."""

import re
from collections.abc import Iterable
from typing import Any

from omegaconf import OmegaConf

from uavrl.errors import UavrlError
from uavrl.reporting.figures import AXES, QUANTITIES, colour, last_success, learning_curves, plotly_script
from uavrl.reporting.report import Report

NOTHING = "–"
_COMMIT = 12  # digits shown
WORDS = {
    "ABR": "what pays the steps of flights that arrived once more",
    "ABR⁺": "ABR with classes of states that were learned beforehand",
    "FORK": "a learned model that lets the actor look ahead",
    "LG": "LifeGuard, which learns what ends in a collision",
    "TR": "the traditional reward: progress, a prize and a punishment",
    "Eq. 3.6": "the thesis's navigation reward, as printed",
    "prize": "the navigation reward with a prize for arriving",
}


def percent(rate: float | None) -> str:
    """A rate for a person."""
    return NOTHING if rate is None else f"{100 * rate:.1f} %"


def interval(low: float, high: float) -> str:
    """Two rates, in percent."""
    return f"{100 * low:.1f}–{100 * high:.1f}"


def number(value: Any, digits: int = 0) -> str:
    """A number with thousands separated."""
    return NOTHING if not isinstance(value, int | float) else f"{value:,.{digits}f}"


def reached(steps: list[int | None]) -> str:
    """Steps to a success rate, for each seed."""
    return " / ".join("not reached" if value is None else f"{value:,}" for value in steps)


def made_by(versions: dict[str, Any]) -> str:
    """Which code made a run."""
    if "uavrl" not in versions:
        return "version not recorded"
    digits, dash, dirty = str(versions.get("commit", "not recorded")).partition("-")
    return f"uavrl {versions['uavrl']}, commit {digits[:_COMMIT]}{dash}{dirty}"


def config_text(config: dict[str, Any]) -> str:
    """A configuration as yaml."""
    return OmegaConf.to_yaml(OmegaConf.create(config))


def words(labels: Iterable[str]) -> dict[str, str]:
    """What the names in the labels of groups mean.

    Examples:
        >>> list(words(["TD3-LG (MLP), TR", "TD3 + ABR⁺, prize"]))
        ['ABR⁺', 'LG', 'TR', 'prize']
    """
    told = [f" {re.sub('[-,()]', ' ', label)} " for label in labels]
    return {word: meaning for word, meaning in WORDS.items() if any(f" {word} " in label for label in told)}


def page(report: Report) -> str:
    """The whole page.

    Args:
        report: what it tells.

    Raises:
        UavrlError: where plotly or jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError:
        raise UavrlError("A report needs jinja2, which is not installed: pip install 'uavrl[report]'.") from None
    environment = Environment(
        loader=PackageLoader("uavrl.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters = (percent, interval, number, reached, made_by, config_text)
    environment.filters.update({each.__name__: each for each in filters})
    facts = report.facts()
    drawn = {label: curve["success"]["episodes"]["seeds"] for label, curve in facts["curves"].items()}
    short = [label for label, seeds in drawn.items() if all(len(x) < 2 for x, _ in seeds)]
    return environment.get_template("report.html").render(
        facts,
        axes=AXES,
        quantities=QUANTITIES,
        words=words(group["label"] for group in report.groups),
        colours=[colour(index) for index in range(len(report.groups))],
        success_figure=last_success(facts),
        curve_figures=learning_curves(facts) if len(short) < len(drawn) else {},
        too_short=short,
        plotly_script=plotly_script(),
    )
