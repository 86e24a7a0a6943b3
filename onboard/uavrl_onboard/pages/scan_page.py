"""One page that shows what a LiDAR saw and what a reduction makes of it; it needs no network, and neither PyTorch."""

from pathlib import Path
from typing import Any

import numpy as np

from uavrl_onboard.files import replacing
from uavrl_onboard.geometry import is_return, within
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.summary import SECTORS, ScanSummary
from uavrl_onboard.pages.assembly import filled, pack
from uavrl_onboard.pages.shapes import BODY, shell, vehicle
from uavrl_onboard.perception.cells import Statistic
from uavrl_onboard.perception.reductions import REDUCTIONS, Reduction, directions
from uavrl_onboard.vehicle import VEHICLE

MOST_POINTS = 6000  # of each scan that are drawn
FARTHEST = 12.0  # m: what is farther is not drawn


def scan_page_data(
    summary: ScanSummary, source: str, reduction: Reduction, statistic: Statistic, radius: float
) -> dict[str, Any]:
    """The content of the page, as JSON."""
    shape = shell(directions(reduction), radius)
    return {
        "source": source,
        "facts": summary.facts(),
        "sectors": [{"name": name, "nearest": summary.sectors().get(name)} for name in SECTORS],
        "cells": f"{len(directions(reduction))} {'faces' if reduction == 'truncated_icosahedron' else 'cells'}",
        "statistic": statistic,
        "radius": radius,
        "reach": FARTHEST,
        "body": BODY,
        "sensor": list(VEHICLE.lidar_position),
        "vehicle": [
            {"vertices": pack(mesh.vertices), "triangles": pack(mesh.faces), "colour": colour}
            for mesh, colour in vehicle()
        ],
        "ball": {name: pack(value) for name, value in shape._asdict().items()},
        "scans": [_scan(scan, reduction, statistic, radius, summary.kept[0].stamp) for scan in summary.kept],
    }


def _scan(scan: Scan, reduction: Reduction, statistic: Statistic, radius: float, first: float) -> dict[str, Any]:
    points = scan.points[is_return(scan.points, within(FARTHEST))]
    some = np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int)
    return {
        "time": scan.stamp - first,
        "returns": int(is_return(scan.points).sum()),
        "misses": scan.misses / scan.rays if scan.rays else 0.0,
        "points": pack(points[some], scale=FARTHEST / 32767),
        "cells": pack(REDUCTIONS[reduction](scan.points, radius, statistic)),
    }


def write_scan_page(
    summary: ScanSummary, source: str, reduction: Reduction, statistic: Statistic, radius: float, output: Path
) -> None:
    """Writes the page of the scans that a summary has kept."""
    data = scan_page_data(summary, source, reduction, statistic, radius)
    text = filled("scan.html", ("flight.css", "flight_charts.js", "drawing.js", "scan.js"), data)
    with replacing(output) as partial:
        partial.write_text(text, encoding="utf-8")
