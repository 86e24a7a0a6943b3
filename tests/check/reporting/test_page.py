"""A browser draws the report."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.helpers.browser import browser_with
from tests.helpers.folders import several_runs
from tests.helpers.measured import measured
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report

pytestmark = measured

READY = "<body data-ready=true>"  # for browser_with
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_browser_draws_every_figure(tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    file.write_text(page(make_report(several_runs(tmp_path / "runs"), window=10)))
    command = [
        str(CHROMIUM),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=20000",
        "--dump-dom",
    ]
    found = subprocess.run([*command, file.as_uri()], capture_output=True, text=True, timeout=600, check=True).stdout
    figures = re.findall(r'id="plot-([a-z_-]+)"[^>]*js-plotly-plot|js-plotly-plot[^>]*id="plot-([a-z_-]+)"', found)
    assert len(figures) == len(re.findall(r'id="plot-', found)) == 9


def test_on_a_phone_the_success_rate_is_in_sight_and_no_axis_title_is_cut(tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    file.write_text(page(make_report(several_runs(tmp_path / "runs"), window=10)).replace("<body>", READY))
    measure = """
        const box = (e) => e.getBoundingClientRect(), all = (s) => [...document.querySelectorAll(s)];
        return {
          page: document.documentElement.scrollWidth,
          rates: all("table").slice(0, 2).map((table) => box(table.querySelector("tbody td:nth-child(2)")).right),
          titles: all(".xtitle").filter((e) => box(e).width).map((e) => {
            const title = box(e), plot = box(e.closest(".plotly-graph-div"));
            return Math.min(title.left - plot.left, plot.right - title.right, plot.bottom - title.bottom);
          }),
          paragraphs: all("main > p").map((p) => box(p).width),
          tables: all(".scroll").map((table) => box(table).width),
        };
    """
    with browser_with(file) as driver:
        for width in (400, 1200):
            screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
            driver.execute_async_script("setTimeout(arguments[0], 3000)")  # plotly draws again after a change of size
            seen = driver.execute_script(measure)
            assert seen["page"] <= width, "the page itself does not scroll sideways"
            assert len(seen["rates"]) == 2 and max(seen["rates"]) <= width
            assert len(seen["titles"]) == 5 and min(seen["titles"]) >= -1
            assert len(set(seen["paragraphs"] + seen["tables"])) == 1, "text and tables are equally wide"
