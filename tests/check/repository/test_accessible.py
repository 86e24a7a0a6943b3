"""What axe finds wrong with the pages, in light and in dark: nothing."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.browser import browser, open_page
from tests.helpers.flights import small_recording
from tests.helpers.folders import several_runs
from tests.helpers.logged import write_log
from tests.helpers.measured import measured
from tests.helpers.packets import RECORDED
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report
from uavrl.viewer.flight_page import make_page, write_data
from uavrl.viewer.logged_page import logged_page_data
from uavrl_onboard.flight.logged_flight import LoggedFlight
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.summary import ScanSummary
from uavrl_onboard.pages.scan_page import write_scan_page

pytestmark = measured

AXE = find_spec("axe_core_python")
CHECK = """
const tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"], done = arguments[arguments.length - 1];
// WCAG 2.2 has dropped it; plotly names a part of its scene as we name ours
const rules = {"duplicate-id": {enabled: false}};
axe.run(document, {runOnly: tags, rules}).then(
  found => done(found.violations.map(each => [each.id, each.nodes.map(node => node.html.slice(0, 200))])),
  error => done([["axe failed", String(error)]]));
"""


LOADED = "document.readyState == 'complete'"


@pytest.fixture
def driver(tmp_path: Path) -> Iterator[Any]:
    if AXE is None:
        pytest.skip("needs axe: pip install axe-core-python")
    with browser(tmp_path, "1280,720") as opened:
        yield opened


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    (folder / "report.html").write_text(page(make_report(several_runs(folder / "runs"), window=10)), encoding="utf-8")
    (folder / "flight.html").write_text(make_page(small_recording()), encoding="utf-8")
    log, _ = write_log(folder / "flight.mcap")
    write_data(logged_page_data(LoggedFlight(log)), folder / "logged.html")
    summary = ScanSummary()
    for scan in ScanSource(RECORDED, "VLP16"):
        summary.add(scan)
    write_scan_page(summary, "a recording", "truncated_icosahedron", "face", 4.0, folder / "scan.html")
    return folder


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("name", ["report", "flight", "logged", "scan"])
def test_axe_finds_nothing(driver: Any, pages: Path, name: str, theme: str) -> None:
    wanted = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", wanted)
    open_page(driver, pages / f"{name}.html", LOADED)
    assert driver.execute_script("return matchMedia('(prefers-color-scheme: dark)').matches") == (theme == "dark")
    (axe,) = (Path(place) / "axe.min.js" for place in AXE.submodule_search_locations)
    driver.execute_script(axe.read_text(encoding="utf-8"))
    assert driver.execute_async_script(CHECK) == []


def test_a_report_is_no_wider_than_a_small_window(driver: Any, pages: Path) -> None:
    size = {"width": 600, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    open_page(driver, pages / "report.html", LOADED)
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 600
