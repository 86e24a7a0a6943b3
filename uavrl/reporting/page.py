"""One HTML page from a report's facts: it fetches nothing, unless plotly is to come from its CDN."""

from __future__ import annotations

from typing import Any

from omegaconf import OmegaConf

from uavrl.errors import UavrlError
from uavrl.reporting.figures import (
    AXES,
    CDN,
    QUANTITIES,
    altitude_histograms,
    colour,
    last_success,
    learning_curves,
    plotly_script,
)
from uavrl.reporting.report import Report

NOTHING = "–"
_COMMIT = 12  # digits shown


def percent(rate: float | None) -> str:
    """A rate for a person.

    Examples:
        >>> percent(0.84), percent(None)
        ('84.0 %', '–')
    """
    return NOTHING if rate is None else f"{100 * rate:.1f} %"


def whole_percent(rate: float) -> str:
    """A threshold for a person.

    Examples:
        >>> whole_percent(0.78), whole_percent(0.785)
        ('78 %', '78.5 %')
    """
    return f"{100 * rate:.4g} %"


def points(difference: float) -> str:
    """A difference of two rates, in percentage points.

    Examples:
        >>> points(-0.12), points(0.034)
        ('−12.0', '+3.4')
    """
    return f"{100 * difference:+.1f}".replace("-", "−")


def interval(rate: dict[str, float | None]) -> str:
    """The ends of a rate's interval, in percent.

    Examples:
        >>> interval({"rate": 0.84, "low": 0.805, "high": 0.87}), interval({"rate": 0.84, "low": None, "high": None})
        ('80.5–87.0', '–')
    """
    low, high = rate["low"], rate["high"]
    return NOTHING if low is None or high is None else f"{100 * low:.1f}–{100 * high:.1f}"


def number(value: Any, digits: int = 0) -> str:
    """A number with thousands separated.

    Examples:
        >>> number(65980), number(0.786, 2), number(None)
        ('65,980', '0.79', '–')
    """
    return NOTHING if not isinstance(value, int | float) else f"{value:,.{digits}f}"


def p_value(value: float | None) -> str:
    """A p value to two digits.

    Examples:
        >>> p_value(0.2104), p_value(0.00004), p_value(None)
        ('0.21', '< 0.001', '–')
    """
    return NOTHING if value is None else "< 0.001" if value < 0.001 else f"{value:.2g}"


def spread(percentiles: dict[str, float]) -> str:
    """The 5, 50 and 95 % percentiles of a length in m.

    Examples:
        >>> spread({"p5": 2.0, "p50": 3.456, "p95": 4.9})
        '2.0 / 3.5 / 4.9 m'
    """
    return f"{percentiles['p5']:.1f} / {percentiles['p50']:.1f} / {percentiles['p95']:.1f} m"


def seeds(values: list[int]) -> str:
    """A list of seeds for a person.

    Examples:
        >>> seeds([0]), seeds([0, 1, 2])
        ('1 (0)', '3 (0, 1, 2)')
    """
    return f"{len(values)} ({', '.join(map(str, values))})"


def reached(steps: list[int | None]) -> str:
    """Steps to a success rate, for each seed.

    Examples:
        >>> reached([65980, None]), reached([None])
        ('65,980 / not reached', 'not reached')
    """
    return " / ".join("not reached" if value is None else f"{value:,}" for value in steps)


def made_by(versions: dict[str, Any]) -> str:
    """Which code made a run.

    Examples:
        >>> made_by({"uavrl": "0.1.0", "commit": "0123456789abcdef-dirty"}), made_by({})
        ('uavrl 0.1.0, commit 0123456789ab-dirty', 'version not recorded')
    """
    if "uavrl" not in versions:
        return "version not recorded"
    commit = versions.get("commit")
    if not commit:
        return f"uavrl {versions['uavrl']}, commit not recorded"
    digits, _, dirty = str(commit).partition("-")
    return f"uavrl {versions['uavrl']}, commit {digits[:_COMMIT]}{'-' + dirty if dirty else ''}"


def config_text(config: dict[str, Any]) -> str:
    """A configuration as yaml."""
    return OmegaConf.to_yaml(OmegaConf.create(config))


def page(report: Report, cdn: bool = False) -> str:
    """The whole page.

    Args:
        report: what it tells.
        cdn: fetch plotly when the page is opened, instead of carrying its 5 MB.

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
    filters = (percent, whole_percent, points, interval, number, p_value, spread, seeds, reached, made_by, config_text)
    environment.filters.update({each.__name__: each for each in filters})
    facts = report.facts()
    return environment.get_template("report.html").render(
        facts,
        axes=AXES,
        quantities=QUANTITIES,
        colours=[colour(index) for index in range(len(report.groups))],
        curve_figures=learning_curves(facts),
        success_figure=last_success(facts),
        altitude_figures=altitude_histograms(facts),
        plotly_script=plotly_script(cdn),
        plotly_source=CDN if cdn else "",
        warnings=report.warnings(),
    )
