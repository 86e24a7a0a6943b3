"""The figures of a report, as plotly draws them; colours are those of Okabe and Ito (2008)."""

from typing import Any

from uavrl.errors import UavrlError

# Told apart by the colour-blind too; the palette's yellow and black are left out, they fade on white and on dark pages.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#808080")
QUANTITIES = {"success": "Success", "collision": "Collision", "time_out": "Time-out", "return": "Return"}
AXES = {"steps": "environment steps", "episodes": "episodes"}
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
_GREY = "#7d8490"  # readable on white and on dark pages


def plotly_script() -> str:
    """The script element that brings plotly into the page, to be put there once."""
    from plotly.offline import get_plotlyjs

    return f"<script>{get_plotlyjs()}</script>"


def figure() -> Any:
    """An empty figure."""
    try:
        from plotly.graph_objects import Figure
    except ImportError:
        raise UavrlError("A report needs plotly, which is not installed: pip install 'uavrl[report]'.") from None
    return Figure(layout={"template": "none", "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)"})


def colour(index: int) -> str:
    """Of the group with this place in the report."""
    return COLOURS[index % len(COLOURS)]


def learning_curves(facts: dict[str, Any]) -> dict[str, dict[str, str]]:
    """HTML of one figure for each axis and quantity; every trace's ``meta`` is the place of its group."""
    return {axis: {name: _learning_curve(facts, name, axis) for name in QUANTITIES} for axis in AXES}


def _learning_curve(facts: dict[str, Any], name: str, axis: str) -> str:
    drawn = figure()
    scale, unit = (1, "") if name == "return" else (100, " %")
    hover = f"%{{x:,.0f}} {AXES[axis]}<br>{QUANTITIES[name].lower()} %{{y:.1f}}{unit}"
    for index, group in enumerate(facts["groups"]):
        curve, paint, several = facts["curves"][group["label"]][name][axis], colour(index), len(group["seeds"]) > 1
        dash = "longdashdot" if index >= len(COLOURS) else "solid" if several else "dot"
        common = {"mode": "lines", "meta": index, "showlegend": False}
        for edge, fill in (("low", None), ("high", "tonexty")):
            band = {"line": {"width": 0}, "hoverinfo": "skip", "fill": fill, "fillcolor": f"{paint}29"}
            drawn.add_scatter(x=curve["x"], y=_scaled(curve[edge], scale), **band, **common)
        lines = [
            (f"seed {seed}", x, y, not several) for seed, (x, y) in zip(group["seeds"], curve["seeds"], strict=True)
        ]
        if several:
            lines.append((f"mean of {len(group['seeds'])} seeds", curve["x"], curve["mean"], True))
        for what, x, y, thick in lines:
            line = {"color": paint, "width": 2.5 if thick else 1, "dash": dash}
            title = {"name": f"{group['label']}, {what}", "hovertemplate": hover, "opacity": 1.0 if thick else 0.45}
            drawn.add_scatter(x=x, y=_scaled(y, scale), line=line, **title, **common)
    if name == "success":
        at = {"text": f"{100 * facts['threshold']:.4g} %", "font": {"size": 11, "color": _GREY}, "x": 0.008}
        line = {"color": _GREY, "width": 1, "dash": "dash"}
        drawn.add_hline(
            y=100 * facts["threshold"], line=line, annotation={**at, "xanchor": "left", "yanchor": "bottom"}
        )
    drawn.update_xaxes(title=AXES[axis], rangemode="tozero", tickformat="~s")
    drawn.update_yaxes(ticksuffix=unit, nticks=6, range=[0, 100] if name in ("success", "collision") else None)
    return _html(drawn, f"{axis}-{name}", 300)


def last_success(facts: dict[str, Any]) -> str:
    """HTML of one figure: success of each run over its last episodes, with its interval, one row for each group."""
    drawn, count = figure(), len(facts["groups"])
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
            marker={"size": 9, "color": colour(index)},
            showlegend=False,
            name=group["label"],
            text=[f"seed {run['seed']}" for run in runs],
            hovertemplate="%{text}: %{x:.1f} %",
        )
    labels = [group["label"] for group in reversed(facts["groups"])]
    drawn.update_xaxes(ticksuffix=" %", title=f"success, last {facts['window']:,} training episodes")
    drawn.update_yaxes(tickvals=list(range(count)), ticktext=labels, range=[-0.6, count - 0.4], automargin=True)
    return _html(drawn, "last-success", 110 + 46 * count)


def _scaled(values: list[float], scale: float) -> list[float]:
    return [round(scale * value, 3) for value in values]


def _html(drawn: Any, name: str, height: int) -> str:
    drawn.update_layout(
        height=height,
        margin={"l": 52, "r": 12, "t": 8, "b": 44},
        font={"family": FONT, "size": 12, "color": "#374151"},
        hoverlabel={"namelength": -1},
        dragmode=False,  # a finger on the figure scrolls the page
    )
    drawn.update_xaxes(gridcolor="#eceef1", zeroline=False, showline=True, linecolor="#9ca3af")
    drawn.update_yaxes(gridcolor="#eceef1", zeroline=False)
    config = {"responsive": True, "displayModeBar": False}
    return drawn.to_html(
        full_html=False, include_plotlyjs=False, div_id=f"plot-{name}", config=config, default_height=f"{height}px"
    )
