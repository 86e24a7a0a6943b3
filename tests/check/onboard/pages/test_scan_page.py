"""A real browser shows the page of a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.helpers.browser import browser_with
from tests.helpers.measured import measured
from tests.helpers.packets import RECORDED
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.summary import ScanSummary
from uavrl_onboard.pages.scan_page import write_scan_page
from uavrl_onboard.perception.reductions import range_image

pytestmark = measured


def test_a_browser_shows_scans_and_cells_without_errors(tmp_path: Path) -> None:
    summary = ScanSummary()
    for scan in ScanSource(RECORDED, "VLP16"):
        summary.add(scan)
    write_scan_page(summary, "a recording", "range_image", "proximity", 4.0, tmp_path / "page.html")
    with browser_with(tmp_path / "page.html") as driver:
        for moment, scan in enumerate(summary.kept):
            seen = driver.execute_script(
                """
                show(arguments[0]);
                const { data: all } = $("scene"), clear = (colour) => colour.endsWith("0.10)");
                return {points: all[POINTS].x.length, clear: all[FACES].facecolor.filter(clear).length,
                        said: $("smoothness").textContent, place: $("slider").value};
                """,
                moment,
            )
            near = int((range_image(scan.points) > 0).sum())
            assert seen["points"] == 6000 and seen["place"] == str(moment)
            assert seen["clear"] == 2 * (72 - near), "two triangles a cell"
            assert f"{len(scan.points):,}" in seen["said"] and f"{near} of 72" in seen["said"]
        facts = driver.find_element("id", "facts").get_attribute("textContent")
        assert "scans2" in facts and "9.91 Hz" in facts and "0.50 m" in facts
        nearest = driver.find_element("id", "position_stats").get_attribute("textContent")
        assert nearest.count(" m") == np.isfinite(summary.nearest).sum()
        for button in driver.find_elements("css selector", "#views button, #layers button"):
            driver.execute_script("arguments[0].click()", button)
        assert driver.execute_script("return $('scene').data[POINTS].visible") is False
        driver.execute_script("play(true); play(false);")
        errors = [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
        assert not errors, errors
