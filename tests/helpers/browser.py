"""A real browser with a page of ours."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CHROMEDRIVER = shutil.which("chromedriver")


_SECONDS = 120  # that a page or a script may take: without a graphics card, and on a busy machine
_FLAGS = (
    "headless no-sandbox disable-gpu disable-quic no-first-run disable-background-networking disable-component-update "
    "disable-sync disable-dev-shm-usage use-angle=swiftshader enable-unsafe-swiftshader"
)


@contextmanager
def browser(profile: Path, size: str) -> Iterator[Any]:
    """A browser with a window of ``WIDTH,HEIGHT``, whose profile lies in a folder."""
    if CHROMIUM is None or CHROMEDRIVER is None:
        pytest.skip("needs chromium and chromedriver: apt-get install chromium chromium-driver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: pip install selenium")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.page_load_strategy = "none"
    for flag in [*_FLAGS.split(), f"window-size={size}", f"user-data-dir={profile}"]:
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    from urllib3 import Retry

    with patch.object(Retry, "DEFAULT", Retry(0)):  # else a browser that hangs is waited for four times
        service = webdriver.ChromeService(CHROMEDRIVER)
        driver = webdriver.Chrome(options=options, service=service)
        waited = driver.command_executor.client_config
        try:
            driver.set_script_timeout(_SECONDS)
            waited.timeout = _SECONDS + 20
            yield driver
        finally:
            waited.timeout = 20
            try:
                driver.quit()
            finally:
                service.process.kill()


def open_page(driver: Any, page: Path, ready: str) -> None:
    """Opens a page, and waits until an expression says that it is ready."""
    driver.get(page.as_uri())
    until = time.monotonic() + _SECONDS
    while not driver.execute_script(f"return location.href == arguments[0] && ({ready})", page.as_uri()):
        assert time.monotonic() < until, driver.get_log("browser")
        time.sleep(0.2)


@contextmanager
def browser_with(page: Path) -> Iterator[Any]:
    """A browser with a page that has said that it is ready; its profile lies beside the page."""
    with browser(page.parent / "profile", "700,500") as driver:
        open_page(driver, page, "document.body && document.body.dataset.ready")
        yield driver
