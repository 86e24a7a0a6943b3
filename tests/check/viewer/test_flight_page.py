"""A real browser plays the page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.browser import browser_with
from tests.helpers.flights import small_recording
from tests.helpers.logged import ATTITUDE, SILENT, write_log
from tests.helpers.measured import measured
from uavrl.viewer.flight_page import write_data, write_page
from uavrl.viewer.logged_page import logged_page_data
from uavrl_onboard.flight.logged_flight import LoggedFlight

pytestmark = measured


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    page = tmp_path / "browser" / "page.html"
    page.parent.mkdir()
    recording = small_recording()
    write_page(replace(recording, source={**recording.source, "training_steps": 12_345}), page)
    with browser_with(page) as driver:
        yield driver


def test_a_browser_plays_the_flight_without_errors(browser: Any) -> None:
    flight = small_recording().flights[0]
    assert browser.title == "straight, 12,345 training steps – uavrl replay"
    assert browser.find_element("id", "source").text == "straight, 12,345 training steps"
    move = """
        document.getElementById("slider").value = arguments[0];
        document.getElementById("slider").dispatchEvent(new Event("input"));
        const gd = document.getElementById("scene"), mark = gd.data[MARK], colours = new Set(gd.data[FACES].facecolor);
        const scene = gd._fullLayout.scene._scene, places = (trace) => ["x", "y", "z"].map((a) => Array.from(trace[a]));
        return {uav: [mark.x[0], mark.y[0], mark.z[0]], clock: document.getElementById("clock").textContent,
                shades: colours.size, points: gd.data[POINTS].x.length, flown: gd.data[FLOWN].x.length,
                drawn: places(scene.traces[gd._fullData[VEHICLE].uid].data), vehicle: places(gd.data[VEHICLE])};
    """
    last = flight.summary.steps
    for moment in (0, last // 2, last):
        seen = browser.execute_script(move, moment)
        np.testing.assert_allclose(seen["uav"], flight.positions[moment], atol=1e-5)
        assert seen["drawn"] == seen["vehicle"], "what is drawn is what is known"
        assert np.abs(np.mean(seen["vehicle"], axis=1) - flight.positions[moment]).max() < 0.15
        assert f"step {moment} / {last}" in seen["clock"]
        assert seen["flown"] == moment + 1 and seen["points"] > 100 and seen["shades"] > 1
    assert browser.execute_script("return document.querySelectorAll('#charts svg polyline').length") >= 7
    panels = browser.execute_script(
        "return [...document.querySelectorAll('.chart h2')].map((head) => head.firstChild.data)"
    )
    assert panels == ["Reward", "Distance to goal", "Clearance", "Altitude", "Speed"], "what was not recorded is absent"
    assert "0.00" not in browser.find_element("id", "facts").text or flight.summary.outcome == "collided"
    smooth = browser.find_element("id", "smoothness").get_attribute("textContent")
    assert "m/s" in smooth and "rad/s" in smooth and smooth.endswith(" %")
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert not errors, errors


def test_in_a_low_window_the_charts_lie_above_the_numbers(browser: Any) -> None:
    size = browser.get_window_size()
    browser.set_window_size(1100, 600)
    try:
        bottom = "return document.querySelector('.chart:last-child').getBoundingClientRect().bottom"
        top = "return document.getElementById('position_stats').getBoundingClientRect().top"
        assert browser.execute_script(bottom) <= browser.execute_script(top)
    finally:
        browser.set_window_size(size["width"], size["height"])


def test_a_browser_plays_and_steps_by_keys_wherever_the_mouse_has_been(browser: Any) -> None:
    from selenium.webdriver import ActionChains, Keys

    clock = "return document.getElementById('clock').textContent"

    def step() -> int:
        return int(browser.execute_script(clock).split("step ")[1].split(" /")[0])

    def press(key: str) -> None:
        ActionChains(browser).send_keys(key).perform()

    browser.execute_script("play(false); show(3);")
    browser.find_element("css selector", "#views button").click()
    press(Keys.ARROW_RIGHT)
    assert step() == 4
    browser.execute_script("document.getElementById('slider').focus();")
    press(Keys.ARROW_LEFT)
    assert step() == 3, "one step, not two"
    press(" ")
    assert browser.execute_script("return playing"), "the slider leaves Space to playing"
    press(" ")
    assert not browser.execute_script("return playing")


def test_a_browser_shows_another_flight_and_other_views(browser: Any) -> None:
    flight = small_recording().flights[1]
    shown = browser.execute_async_script("""
        const done = arguments[0];
        choose(1).then(() => {
          for (const button of document.querySelectorAll("#views button, #layers button")) button.click();
          const gd = document.getElementById("scene"), mark = gd.data[MARK];
          done({uav: [mark.x[0], mark.y[0], mark.z[0]], eye: gd.layout.scene.camera.eye,
                hidden: gd.data[POINTS].visible, task: document.getElementById("facts").textContent});
        });
    """)
    np.testing.assert_allclose(shown["uav"], flight.positions[0], atol=1e-5)
    assert shown["hidden"] is False and all(np.isfinite(list(shown["eye"].values())))
    assert f"task{flight.summary.task}" in shown["task"]
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert not errors, errors


def test_what_is_seen_to_move_is_drawn_where_it_is_and_where_it_will_be(tmp_path: Path, browser: Any) -> None:
    replay = small_recording()
    objects = np.zeros((replay.flights[0].summary.steps + 1, 3, 7))
    objects[4:, 1] = 1.0, 2.0, 3.0, 0.0, 4.0, 0.0, 0.8
    write_page(replace(replay, flights=(replace(replay.flights[0], objects=objects),)), tmp_path / "page.html")
    drawn = """
        show(arguments[0]);
        const {x, y, z} = document.getElementById("scene").data[OBJECTS];
        return [x, y, z].map((axis) => Array.from(axis).filter((v) => v !== null));
    """
    layers = "return document.getElementById('layers').textContent"
    assert "seen to move" not in browser.execute_script(layers), "where nothing looks for it"
    with browser_with(tmp_path / "page.html") as driver:
        assert "seen to move" in driver.execute_script(layers)
        assert driver.execute_script(drawn, 3) == [[], [], []]
        x, y, z = (np.array(axis) for axis in driver.execute_script(drawn, 4))
    np.testing.assert_allclose(np.hypot(x[:-2] - 1, y[:-2] - 2), 0.4, atol=1e-5)
    np.testing.assert_allclose([x[-2:], y[-2:]], [[1, 1], [2, 6]], atol=1e-5)
    np.testing.assert_allclose(z, 3.0)


def test_it_opens_with_an_overview_and_then_follows_the_uav_until_somebody_looks_elsewhere(browser: Any) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    held = """
        const waiting = new Map(), [later, never] = [setTimeout, clearTimeout];
        window.setTimeout = (call, ms, ...rest) => ms === 2000 ? (waiting.set(-1, call), -1) : later(call, ms, ...rest);
        window.clearTimeout = (id) => id === -1 ? waiting.delete(-1) : never(id);
        window.waiting = waiting;
    """
    browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": held})
    browser.refresh()
    WebDriverWait(browser, 300).until(
        lambda page: page.execute_script("return window.waiting && document.body?.dataset.ready")
    )
    at = "const at = () => [view, document.querySelector('#views .on').textContent, waiting.size];"
    assert browser.execute_script(f"{at} return at()") == ["overview", "overview", 1]
    assert browser.execute_script(f"{at} waiting.get(-1)(); return at()") == ["chase", "chase", 0]
    for touch in ("look('top')", "document.getElementById('scene').dispatchEvent(new Event('pointerdown'))"):
        script = f"opening = setTimeout(() => look('chase'), OPENING); {touch}; return waiting.size"
        assert browser.execute_script(script) == 0, touch
    entries = "return [...document.getElementById('legend').children].map((entry) => entry.textContent)"
    assert {"goal", "cells and points, by distance:"} <= set(browser.execute_script(entries))


def test_a_browser_plays_the_log_of_a_real_flight(tmp_path: Path) -> None:
    log, flown = write_log(tmp_path / "flight.mcap")
    write_data(logged_page_data(LoggedFlight(log)), tmp_path / "page.html")
    shown = [cycle for cycle in flown if cycle.pose is not None]
    move = """
        show(arguments[0]);
        const gd = document.getElementById("scene"), mark = gd.data[MARK];
        return {uav: [mark.x[0], mark.y[0], mark.z[0]], told: document.getElementById("told").innerText,
                vehicle: ["x", "y", "z"].map((axis) => Array.from(gd.data[VEHICLE][axis])),
                shape: Array.from(vehicle.vertices),
                clock: document.getElementById("clock").textContent, points: gd.data[POINTS].x[0] !== null};
    """
    with browser_with(tmp_path / "page.html") as browser:
        for moment in (0, SILENT[0] + 2, 56):
            seen, cycle = browser.execute_script(move, moment), shown[moment]
            assert cycle.pose is not None
            np.testing.assert_allclose(seen["uav"], cycle.pose.position, atol=1e-5)
            tilted = ATTITUDE.apply(np.reshape(seen["shape"], (-1, 3))) + cycle.pose.position
            np.testing.assert_allclose(np.transpose(seen["vehicle"]), tilted, atol=1e-5)
            told = [f"{cycle.status.state} ({cycle.status.reason})", cycle.status.sentence, cycle.control.sentence]
            assert seen["told"].split("\n") == told and f"cycle {moment} / 56" in seen["clock"]
            assert seen["points"] == (moment != SILENT[0] + 2)
        heads = "return [...document.querySelectorAll('.chart h2')].map((head) => head.firstChild.data)"
        charts = ["Safety layer", "Distance to goal", "Nearest return", "Forward", "Yaw rate", "Altitude", "Speed"]
        assert browser.execute_script(heads) == charts
        bands = browser.execute_script("return document.querySelectorAll('#charts svg rect').length")
        changes = sum(one.status.state != other.status.state for one, other in pairwise(shown))
        assert bands == changes + 1
        visible = "return [...document.querySelectorAll('aside > h2')].filter((head) => head.offsetParent).length"
        assert browser.execute_script(visible) == 0, "what a log does not know has no heading"
        for button in browser.find_elements("css selector", "#views button, #layers button"):
            browser.execute_script("arguments[0].click()", button)
        errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        assert not errors, errors
