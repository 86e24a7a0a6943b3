"""A browser draws the report."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.helpers.folders import several_runs
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report

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
