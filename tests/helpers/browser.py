"""A real browser with a page of ours."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CHROMEDRIVER = shutil.which("chromedriver")


@contextmanager
def browser_with(page: Path) -> Iterator[Any]:
    """Opens a page, and waits until it says that it is ready; its profile lies beside the page."""
    if CHROMIUM is None or CHROMEDRIVER is None:
        pytest.skip("needs chromium and chromedriver: apt-get install chromium chromium-driver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: pip install selenium")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.page_load_strategy = "none"
    flags = "headless no-sandbox disable-gpu disable-quic no-first-run disable-background-networking "
    flags += "disable-component-update disable-sync use-angle=swiftshader enable-unsafe-swiftshader "
    flags += f"window-size=700,500 user-data-dir={page.parent / 'profile'}"
    for flag in flags.split():
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(CHROMEDRIVER))
    try:
        driver.set_script_timeout(900)  # without a graphics card, and on a busy machine
        driver.command_executor.client_config.timeout = 1000
        driver.get(page.as_uri())
        ready = "return document.body && document.body.dataset.ready"
        until = time.monotonic() + 900
        while not driver.execute_script(ready):
            assert time.monotonic() < until, driver.get_log("browser")
            time.sleep(0.5)
        yield driver
    finally:
        driver.quit()
