"""The figures of a report, as plotly draws them; colours are those of Okabe and Ito (2008)."""

from __future__ import annotations

import base64
import hashlib
from typing import Any

from uavrl.errors import UavrlError

# Told apart by the colour-blind too; the palette's yellow is left out, it is too pale for lines on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
QUANTITIES = {"success": "Success", "collision": "Collision", "time_out": "Time-out", "return": "Return"}
AXES = {"steps": "environment steps", "episodes": "episodes"}
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
CDN = "https://cdn.plot.ly"
_GREY = "#6b7280"


def plotly_script(cdn: bool = False) -> str:
    """The script element that brings plotly into the page, to be put there once.

    Args:
        cdn: fetch plotly when the page is opened, the same file by its hash, instead of carrying its 5 MB.

    Raises:
        UavrlError: where plotly is not installed.
    """
    _objects()
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    javascript = get_plotlyjs()
    if not cdn:
        return f"<script>{javascript}</script>"
    digest = base64.b64encode(hashlib.sha256(javascript.encode()).digest()).decode()
    address = f"{CDN}/plotly-{get_plotlyjs_version()}.min.js"
    return f'<script src="{address}" integrity="sha256-{digest}" crossorigin="anonymous"></script>'


def _objects() -> Any:
    try:
        import plotly.graph_objects
    except ImportError:
        raise UavrlError("A report needs plotly, which is not installed: pip install 'uavrl[report]'.") from None
    return plotly.graph_objects


def colour(index: int) -> str:
    """Of the group with this place in the report."""
    return COLOURS[index % len(COLOURS)]


def dash(index: int, seeds: int) -> str:
    """Of a group's line: dotted for one seed, and another kind where the colours are used up."""
    return "dot" if seeds == 1 else "solid" if index < len(COLOURS) else "longdashdot"


def learning_curves(facts: dict[str, Any]) -> dict[str, dict[str, str]]:
    """HTML of one figure for each axis and quantity; every trace's ``meta`` is the place of its group."""
    return {axis: {name: _learning_curve(facts, name, axis) for name in QUANTITIES} for axis in AXES}


def _learning_curve(facts: dict[str, Any], name: str, axis: str) -> str:
    go = _objects()
    figure = go.Figure()
    scale, unit = (1, "") if name == "return" else (100, " %")
    hover = f"%{{x:,.0f}} {AXES[axis]}<br>{QUANTITIES[name].lower()} %{{y:.1f}}{unit}"
    for index, group in enumerate(facts["groups"]):
        curve, paint = facts["curves"][group["label"]][name][axis], colour(index)
        common = {"mode": "lines", "meta": index, "showlegend": False}
        if curve["x"]:
            band = {"x": curve["x"], "hoverinfo": "skip", "line": {"width": 0}, **common}
            figure.add_scatter(y=_scaled(curve["low"], scale), **band)
            figure.add_scatter(y=_scaled(curve["high"], scale), fill="tonexty", fillcolor=_faint(paint), **band)
        alone = len(group["seeds"]) == 1
        for seed, (x, y) in zip(group["seeds"], curve["seeds"], strict=True):
            line = {"color": paint, "width": 2 if alone else 1, "dash": dash(index, len(group["seeds"]))}
            figure.add_scatter(
                x=x,
                y=_scaled(y, scale),
                name=f"{group['label']}, seed {seed}",
                line=line,
                opacity=1.0 if alone else 0.45,
                hovertemplate=hover,
                **common,
            )
        if curve["x"]:
            figure.add_scatter(
                x=curve["x"],
                y=_scaled(curve["mean"], scale),
                name=f"{group['label']}, mean of {len(group['seeds'])} seeds",
                line={"color": paint, "width": 2.5, "dash": dash(index, len(group["seeds"]))},
                hovertemplate=hover,
                **common,
            )
    if name == "success":
        figure.add_hline(
            y=scale * facts["threshold"],
            line={"color": _GREY, "width": 1, "dash": "dash"},
            annotation={
                "text": f"{100 * facts['threshold']:.4g} %",
                "font": {"size": 11, "color": _GREY},
                "x": 0.008,
                "xanchor": "left",
                "yanchor": "bottom",
            },
        )
    figure.update_xaxes(title=AXES[axis], rangemode="tozero", tickformat="~s")
    figure.update_yaxes(ticksuffix=unit.replace(" ", " "), nticks=6)
    if name in ("success", "collision"):
        figure.update_yaxes(range=[0, 100])
    elif name == "time_out":
        figure.update_yaxes(rangemode="tozero")
    return _html(figure, f"{axis}-{name}", 300)


def last_success(facts: dict[str, Any]) -> str:
    """HTML of one figure: success of each run over its last episodes, with its interval, one row for each group."""
    go = _objects()
    figure = go.Figure()
    labels = [group["label"] for group in facts["groups"]]
    for index, group in enumerate(facts["groups"]):
        runs = [run for run in facts["runs"] if run["group"] == group["label"]]
        for place, run in enumerate(runs):
            rate = run["last"]["success"]
            figure.add_scatter(
                x=[100 * rate["rate"]],
                y=[len(labels) - 1 - index + 0.5 * (0.5 - (place + 0.5) / len(runs))],
                error_x={
                    "array": [100 * (rate["high"] - rate["rate"])],
                    "arrayminus": [100 * (rate["rate"] - rate["low"])],
                    "color": colour(index),
                    "thickness": 1.5,
                    "width": 3,
                },
                mode="markers",
                marker={"size": 9, "color": colour(index), "symbol": "circle-open" if len(runs) < 2 else "circle"},
                showlegend=False,
                name=run["name"],
                hovertemplate=f"seed {run['seed']}: %{{x:.1f}} %",
            )
    lowest = 100 * min(run["last"]["success"]["low"] for run in facts["runs"])
    figure.update_xaxes(ticksuffix=" %", title=f"success, last {facts['window']:,} episodes", range=[lowest - 3, 100.6])
    rows = list(range(len(labels)))
    figure.update_yaxes(tickvals=rows, ticktext=labels[::-1], range=[-0.6, len(labels) - 0.4], automargin=True)
    return _html(figure, "last-success", 110 + 46 * len(labels))


def altitude_histograms(facts: dict[str, Any]) -> list[str]:
    """HTML of one figure for each evaluation that tells where its flights went: its time at each altitude."""
    place = {group["label"]: index for index, group in enumerate(facts["groups"])}
    told = [evaluation for evaluation in facts["evaluations"] if evaluation["whereabouts"]]
    return [_histogram(each["whereabouts"], colour(place[each["group"]]), i) for i, each in enumerate(told)]


def _histogram(found: dict[str, Any], paint: str, index: int) -> str:
    bars = found["altitude_histogram"]
    shares = [100 * count / sum(bars["counts"]) for count in bars["counts"]]
    middles = [bars["low"] + bars["step"] * (place + 0.5) for place in range(len(shares))]
    figure = _objects().Figure()
    hover = f"%{{y:.1f}} % of the time<br>within {bars['step'] / 2:g} m of %{{x:.3f}} m<extra></extra>"
    figure.add_bar(x=middles, y=shares, width=bars["step"], marker={"color": paint}, hovertemplate=hover)
    figure.update_xaxes(title="altitude, m", rangemode="tozero")
    figure.update_yaxes(ticksuffix=" %", nticks=5)
    return _html(figure, f"altitude-{index}", 200)


def _scaled(values: list[float | None], scale: float) -> list[float | None]:
    return [None if value is None else round(scale * value, 3) for value in values]


def _faint(paint: str) -> str:
    red, green, blue = (int(paint[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.16)"


def _html(figure: Any, name: str, height: int) -> str:
    figure.update_layout(
        template="none",
        height=height,
        margin={"l": 52, "r": 12, "t": 8, "b": 44},
        font={"family": FONT, "size": 12, "color": "#374151"},
        hoverlabel={"namelength": -1},
        dragmode=False,  # a finger on the figure scrolls the page
    )
    figure.update_xaxes(gridcolor="#eceef1", zeroline=False, showline=True, linecolor="#9ca3af")
    figure.update_yaxes(gridcolor="#eceef1", zeroline=False)
    config = {"responsive": True, "displayModeBar": False}
    return figure.to_html(
        full_html=False, include_plotlyjs=False, div_id=f"plot-{name}", config=config, default_height=f"{height}px"
    )
