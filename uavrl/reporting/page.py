"""One HTML page from a report's facts, which fetches nothing; its figures are plotly's."""

import re
from collections.abc import Callable, Iterable
from textwrap import wrap
from typing import Any

from omegaconf import OmegaConf

from uavrl.errors import UavrlError
from uavrl.evaluation.smoothness import change_text
from uavrl.reporting.report import Report
from uavrl_onboard.pluralize import pluralize

# Okabe and Ito (2008): the colour-blind can tell them apart; its yellow and black fade on white and on dark pages.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#808080")
QUANTITIES = {"success": "Success", "collision": "Collision", "time_out": "Time-out", "return": "Return"}
AXES = {"steps": "environment steps", "episodes": "episodes"}
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
WORDS = {
    "DAgger": "a network that clones the scripted controller VFH in the states that it reaches itself, preset=dagger",
    "TD3-BC": "TD3 with behaviour cloning towards the scripted controller VFH, preset=td3_bc",
    "ABR": "augmentative backward reward, a bonus for the steps of successful episodes",
    "ABR⁺": "ABR with classes of states that were learned beforehand",
    "FORK": "a learned model of the environment, by which the actor looks ahead",
    "LG": "LifeGuard, a penalty for actions that a classifier expects to end in a collision",
    "TR": "the traditional reward: progress, a bonus for success and a penalty for a collision",
    "Eq. 3.6": "the thesis's navigation reward, as printed",
    "prize": "the navigation reward with a bonus for success",
}
LABEL_WIDTH = 18  # characters of a line of a group's name beside its figure, which fits on a phone
_GREY = "#7d8490"  # readable on white and on dark pages
_LAYOUT = {
    "template": "none",
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "margin": {"l": 52, "r": 12, "t": 8, "b": 44},
    "font": {"family": FONT, "size": 12, "color": "#374151"},
    "hoverlabel": {"namelength": -1},
    "dragmode": False,  # a finger on the figure scrolls the page
    "xaxis": {"gridcolor": "#eceef1", "zeroline": False, "showline": True, "linecolor": "#9ca3af", "automargin": True},
    "yaxis": {"gridcolor": "#eceef1", "zeroline": False, "automargin": True},
}


def page(report: Report) -> str:
    """The whole page of a report.

    Raises:
        UavrlError: where plotly or jinja2 is not installed.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        package = str(error.name).partition(".")[0]
        raise UavrlError(f"A report needs {package}, which is not installed: pip install 'uavrl[report]'.") from error
    environment = Environment(
        loader=PackageLoader("uavrl.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(_FILTERS)
    facts = report.facts()
    drawn = {label: curve["success"]["episodes"]["seeds"] for label, curve in facts["curves"].items()}
    short = [label for label, seeds in drawn.items() if all(len(x) < 2 for x, _ in seeds)]
    axes = AXES if len(short) < len(drawn) else {}
    return environment.get_template("report.html").render(
        facts,
        axes=AXES,
        quantities=QUANTITIES,
        verdict=report.verdict(),
        words=words(group["label"] for group in report.groups),
        colours=[_colour(index) for index in range(len(report.groups))],
        success_figure=_last_success(facts),
        curve_figures={axis: {name: _learning_curve(facts, name, axis) for name in QUANTITIES} for axis in axes},
        too_short=short,
        plotly_script=f"<script>{get_plotlyjs()}</script>",
    )


def _made_by(versions: dict[str, Any]) -> str:
    """The version and the commit, shortened to 12 digits, that made a run."""
    if "uavrl" not in versions:
        return "version not recorded"
    digits, dash, dirty = str(versions.get("commit", "not recorded")).partition("-")
    return f"uavrl {versions['uavrl']}, commit {digits[:12]}{dash}{dirty}"


_FILTERS: dict[str, Callable[..., str]] = {
    "percent": lambda rate: "–" if rate is None else f"{100 * rate:.1f} %",
    "interval": lambda low, high: f"{100 * low:.1f}–{100 * high:.1f}",
    "number": lambda value, digits=0: f"{value:,.{digits}f}" if isinstance(value, int | float) else "–",
    "reached": lambda steps: " / ".join("not reached" if value is None else f"{value:,}" for value in steps),
    "made_by": _made_by,
    "change": change_text,
    "config_text": lambda config: OmegaConf.to_yaml(OmegaConf.create(config)),
}


def words(labels: Iterable[str]) -> dict[str, str]:
    """The meaning of each name in the labels of groups.

    Examples:
        >>> list(words(["TD3-LG (MLP), TR", "TD3 + ABR⁺, prize"]))
        ['ABR⁺', 'LG', 'TR', 'prize']
    """
    spaced = [_spaced(label) for label in labels]
    return {word: meaning for word, meaning in WORDS.items() if any(_spaced(word) in label for label in spaced)}


def _spaced(label: str) -> str:
    return f" {re.sub('[-,()]', ' ', label)} "


def _colour(index: int) -> str:
    """The colour of the group with this place in the report."""
    return COLOURS[index % len(COLOURS)]


def _learning_curve(facts: dict[str, Any], name: str, axis: str) -> str:
    """HTML of a quantity over an axis; each trace's ``meta`` is the place of its group."""
    from plotly.graph_objects import Figure

    drawn = Figure()
    scale, unit = (1, "") if name == "return" else (100, " %")
    hover = f"%{{x:,.0f}} {AXES[axis]}<br>{QUANTITIES[name].lower()} %{{y:.1f}}{unit}"

    def scaled(values: list[float]) -> list[float]:
        return [round(scale * value, 3) for value in values]

    for index, group in enumerate(facts["groups"]):
        curve, paint, several = facts["curves"][group["label"]][name][axis], _colour(index), len(group["seeds"]) > 1
        dash = "longdashdot" if index >= len(COLOURS) else "solid" if several else "dot"
        common = {"mode": "lines", "meta": index, "showlegend": False}
        for edge, fill in (("low", None), ("high", "tonexty")):
            band = {"line": {"width": 0}, "hoverinfo": "skip", "fill": fill, "fillcolor": f"{paint}29"}
            drawn.add_scatter(x=curve["x"], y=scaled(curve[edge]), **band, **common)
        lines = [
            (f"seed {seed}", x, y, not several) for seed, (x, y) in zip(group["seeds"], curve["seeds"], strict=True)
        ]
        if several:
            lines.append((f"mean of {len(group['seeds'])} seeds", curve["x"], curve["mean"], True))
        for line, x, y, thick in lines:
            style = {"color": paint, "width": 2.5 if thick else 1, "dash": dash}
            title = {"name": f"{group['label']}, {line}", "hovertemplate": hover, "opacity": 1.0 if thick else 0.45}
            drawn.add_scatter(x=x, y=scaled(y), line=style, **title, **common)
    for share in sorted({flown[axis] for group in facts["groups"] if (flown := group["demonstrated"])}):
        drawn.add_vrect(x0=0, x1=share, fillcolor=_GREY, opacity=0.16, line_width=0, layer="below")
    if name == "success":
        at = {"text": f"{100 * facts['threshold']:.4g} %", "font": {"size": 11, "color": _GREY}, "x": 0.008}
        style = {"color": _GREY, "width": 1, "dash": "dash"}
        note = {**at, "xanchor": "left", "yanchor": "bottom"}
        drawn.add_hline(y=100 * facts["threshold"], line=style, annotation=note)
    drawn.update_xaxes(title=AXES[axis], rangemode="tozero", tickformat="~s")
    drawn.update_yaxes(rangemode="normal" if name == "return" else "nonnegative")
    drawn.update_yaxes(ticksuffix=unit, nticks=6, range=[0, 100] if name in ("success", "collision") else None)
    return _html(drawn, f"{axis}-{name}", 300)


def _last_success(facts: dict[str, Any]) -> str:
    """HTML of the success rate of each run over its last episodes, with its interval, one row for each group."""
    from plotly.graph_objects import Figure

    drawn, count = Figure(), len(facts["groups"])
    for index, group in enumerate(facts["groups"]):
        runs = [run for run in facts["runs"] if run["group"] == group["label"]]
        rates = [run["last"]["success"] for run in runs]
        drawn.add_scatter(
            x=[100 * rate["rate"] for rate in rates],
            y=[count - 1 - index + 0.5 * (0.5 - (place + 0.5) / len(runs)) for place in range(len(runs))],
            error_x={
                "array": [100 * (rate["high"] - rate["rate"]) for rate in rates],
                "arrayminus": [100 * (rate["rate"] - rate["low"]) for rate in rates],
            },
            mode="markers",
            marker={"size": 9, "color": _colour(index)},
            showlegend=False,
            name=group["label"],
            text=[f"seed {run['seed']}" for run in runs],
            hovertemplate="%{text}: %{x:.1f} %",
        )
    labels = ["<br>".join(wrap(group["label"], LABEL_WIDTH)) for group in reversed(facts["groups"])]
    drawn.update_xaxes(ticksuffix=" %", title=f"success, last {pluralize(facts['window'], 'episode')}")
    drawn.update_yaxes(tickvals=list(range(count)), ticktext=labels, range=[-0.6, count - 0.4], automargin=True)
    return _html(drawn, "last-success", 110 + 46 * count)


def _html(drawn: Any, name: str, height: int) -> str:
    drawn.update_layout(_LAYOUT, height=height)
    config = {"responsive": True, "displayModeBar": False}
    return drawn.to_html(
        full_html=False, include_plotlyjs=False, div_id=f"plot-{name}", config=config, default_height=f"{height}px"
    )
