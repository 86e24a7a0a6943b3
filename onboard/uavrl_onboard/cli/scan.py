"""``uavrl-scan``: what a LiDAR sees, and what a policy would see of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from uavrl_onboard.cli.command import command
from uavrl_onboard.cli.help import About
from uavrl_onboard.cli.lidar_keys import LidarKeys
from uavrl_onboard.errors import Stopped, UavrlError
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.lidar.coverage import Coverage
from uavrl_onboard.lidar.mount import TILTED, mount_tilt, turned
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.sources import ScanSource, without_vehicle
from uavrl_onboard.lidar.summary import ScanSummary
from uavrl_onboard.perception.cells import Statistic
from uavrl_onboard.perception.reductions import STATISTICS, Reduction
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.ranges import Folder, Positive
from uavrl_onboard.sentences import require

LIVE = 1.0  # s between two lines while a sensor is listened to


@dataclass
class ScanConfig(LidarKeys):
    """The keys of ``uavrl-scan``.

    Args:
        source: udp://:2368 listens to a sensor; or a file: a capture (pcap), packets alone (.bin), a rosbag of ROS 1
            or 2, an MCAP file
        seconds: how long to listen to a sensor, in s
        reduction: cells on the page: the 32 faces of a truncated_icosahedron, or the 72 cells of a range_image
        statistic: what a cell reports: face, range or proximity; null: face for the faces, proximity for the range
            image
        radius: radius of the ball that the cells divide, in m
        output: file for the page; null: none
        json: file for the numbers; null: none
    """

    source: Folder | None = None
    seconds: Positive = 10.0
    reduction: Reduction = "truncated_icosahedron"
    statistic: Statistic | None = None
    radius: Annotated[float, Field(ge=0.1, le=1000)] = 4.0
    output: Folder | None = "scan.html"
    json: Folder | None = None

    def __post_init__(self) -> None:
        """Checks that there is a source, and that page and numbers are two files."""
        require(self.source is not None, "source", "a file, a rosbag's folder or udp://:PORT", self.source)
        super().__post_init__()
        apart = self.json is None or self.output is None or Path(self.json).resolve() != Path(self.output).resolve()
        require(apart, "json", "another file than output", self.json)


ABOUT = About(
    "uavrl-scan",
    "Shows the scans of a LiDAR, and the cells that a policy would compute from them.",
    [
        "source=udp://:2368 model=VLP16",
        "source=FILE model=VLP16 json=FILE",
        "source=udp://:7502 metadata=FILE",
        "source=ROSBAG topic=/points",
    ],
    "source model metadata topic seconds mount vehicle reduction statistic radius output json",
)


@command(ABOUT, ScanConfig)
def main(settings: ScanConfig) -> None:
    """Reads a source to its end, or listens for some seconds; prints the numbers, writes page and JSON."""
    source = ScanSource(
        str(settings.source),
        settings.model,
        topic=settings.topic,
        product=settings.product,
        seconds=settings.seconds,
        metadata=settings.metadata,
    )
    settings.require_unturned(source)
    paths = {key: Path(getattr(settings, key)) for key in ("output", "json") if getattr(settings, key) is not None}
    for key, path in paths.items():
        kept = source.kind == "udp" or Path(source.source).resolve() not in (path.resolve(), *path.resolve().parents)
        require(kept, key, "another file than the source, which it would replace", str(path))
    files = {key: writable(path, f"{key}=FILE") for key, path in paths.items()}
    summary, coverage, stopped = ScanSummary(), Coverage(level=mount_tilt(settings.mount) <= TILTED), False
    try:
        for scan in _shown(source, settings, coverage):
            summary.add(scan)
    except KeyboardInterrupt:
        if source.kind != "udp" or not summary.scans:
            raise
        stopped = True  # listening has ended early: what came is written all the same
    _print(summary, source)
    _write(summary, source, settings, files)
    if stopped:
        raise Stopped("stopped: the numbers are those of the scans that came until then.")


def _write(summary: ScanSummary, source: ScanSource, settings: ScanConfig, files: dict[str, Path]) -> None:
    """Writes what was asked for, and says where it is."""
    if "json" in files:
        facts = {**summary.facts(), "nearest_by_direction": summary.sectors(), "skipped": asdict(source.skipped)}
        with replacing(files["json"]) as partial:
            partial.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    drawn = "output" in files and _draw(summary, settings, files["output"])
    for key, path in files.items():
        if key != "output" or drawn:
            print(f"Written to {path}")


def _shown(source: ScanSource, settings: ScanConfig, coverage: Coverage) -> Iterator[Scan]:
    """The scans in the vehicle's axes, without the vehicle.

    Tells what is odd about them, and of a sensor a line each second.
    """
    told, doubted = -np.inf, set[str]()
    for scan in source:
        if settings.rotation is not None:
            scan = replace(scan, points=turned(scan.points, settings.rotation))
        doubt = coverage.add(scan.points)
        if doubt is not None and doubt.kind not in doubted:
            doubted.add(doubt.kind)
            print(f"uavrl: {doubt.sentence[0].upper()}{doubt.sentence[1:]}", file=sys.stderr, flush=True)
        if settings.box is not None:
            scan = replace(scan, points=without_vehicle(scan.points, *settings.box))
        yield scan
        if source.kind == "udp" and scan.stamp - told >= LIVE:
            told = scan.stamp
            moment = ScanSummary()
            moment.add(scan)
            print(f"{_percent(moment)} of {scan.rays:,} rays miss, nearest {_metres(moment)}", flush=True)


def _print(summary: ScanSummary, source: ScanSource) -> None:
    facts = summary.facts()
    rate = "" if facts["rate_hz"] is None else f" at {facts['rate_hz']:.2f} Hz"
    scans = f"{pluralize(summary.scans, 'scan')}{rate}"
    print(f"{source.source}: {scans}, {facts['points_median']:,.0f} points each (median), {_percent(summary)} misses")
    print("Nearest return in each direction:")
    for name, far in summary.sectors().items():
        print(f"  {name:<14}{far:7.2f} m")
    if facts["nearest_m"] is None:
        print("uavrl: No scan holds a return: is the sensor covered, or its laser off?", file=sys.stderr)
    for sentence in source.remarks():
        print(f"uavrl: {sentence}", file=sys.stderr)


def _percent(summary: ScanSummary) -> str:
    return f"{100 * (summary.facts()['misses'] or 0.0):.1f} %"


def _metres(summary: ScanSummary) -> str:
    sectors = summary.sectors()
    if not sectors:
        return "nothing"
    name = min(sectors, key=lambda each: sectors[each])
    return f"{sectors[name]:.2f} m {name}"


def _draw(summary: ScanSummary, settings: ScanConfig, output: Path) -> bool:
    """Write the page; say so if plotly is not installed."""
    try:
        from uavrl_onboard.pages.scan_page import write_scan_page

        statistic = settings.statistic or STATISTICS[settings.reduction]
        write_scan_page(summary, str(settings.source), settings.reduction, statistic, settings.radius, output)
    except UavrlError as error:
        print(f"uavrl: No page was drawn: {error} (output=null asks for none.)", file=sys.stderr)
        return False
    return True


if __name__ == "__main__":
    main()
