"""The page shows the flight's own numbers and needs nothing from outside; a real browser plays it."""

from __future__ import annotations

import json
import re
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.flights import small_recording, unpack
from tests.helpers.pages import Page
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl.flying.recording import Recording
from uavrl.reporting.flight_page import above_ground, make_page, pack, page_data, write_page
from uavrl.reporting.flight_shapes import belt, football, shell
from uavrl.transforms import RangeImage, TruncatedIcosahedron
from uavrl.transforms.functional import truncated_icosahedron_faces
from uavrl.transforms.range_image import range_image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CHROMEDRIVER = shutil.which("chromedriver")


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(make_page(small_recording()))


def test_the_page_fetches_nothing_and_forbids_it() -> None:
    text = make_page(small_recording())
    assert all(address.startswith("data:") for address in Page(text).fetched)
    assert "default-src 'none'" in text
    assert not re.search(r"@import|url\(\s*['\"]?(https?:)?//", text.split("<script>")[0])
    assert not re.findall(r"/\*[\w.]+\.(css|js|json)\*/", text), "a mark of the template is left"


def test_the_numbers_in_the_page_are_those_of_the_flight(page: Page) -> None:
    replay = small_recording()
    data = json.loads(page.scripts["data"])
    assert data["source"] == replay.source
    for shown, flight in zip(data["flights"], replay.flights, strict=True):
        for name in ("positions", "attitudes", "velocities", "goal", "rewards", "faces", "planes", "clearances"):
            np.testing.assert_array_equal(unpack(shown[name]), getattr(flight, name).astype(np.float32), err_msg=name)
        step = shown["points"]["scale"]
        ends = unpack(shown["point_ends"])
        clouds = np.split(unpack(shown["points"]), ends[:-1])
        assert len(clouds) == len(flight.times)
        for moment, cloud in enumerate(clouds):
            whole = flight.cloud(moment)
            nearest = np.abs(whole[None] - cloud[:20, None]).max(-1).min(1)
            assert 0 < len(cloud) <= len(whole) and (nearest <= step).all()
        assert (shown["task"], shown["outcome"]) == (flight.summary.task, flight.summary.outcome)
        assert shown["path_efficiency"] == flight.summary.path_efficiency
        assert shown["reward_names"] == list(flight.reward_names)


def test_a_page_of_many_flights_stays_small() -> None:
    replay = small_recording()
    many = Recording(replay.source, replay.flights * 25, replay.sceneries)
    assert len(make_page(many).encode()) < 15e6


def test_text_from_outside_cannot_leave_the_data() -> None:
    replay = small_recording()
    evil = Recording({"run": "</script><script>alert(1)</script>"}, replay.flights[:1], replay.sceneries)
    page = Page(make_page(evil))
    assert json.loads(page.scripts["data"])["source"] == evil.source
    assert len(page.scripts) == 4


def test_packing() -> None:
    values = np.array([[1.25, -3.0], [0.0, 2.0]])
    np.testing.assert_array_equal(unpack(pack(values)), values)
    np.testing.assert_allclose(unpack(pack(values, scale=3.0 / 32767)), values, atol=0.5 * 3.0 / 32767)
    assert unpack(pack(np.array([3, -4]))).tolist() == [3, -4]


def test_the_football_is_that_of_the_reduction() -> None:
    shape, faces = football(4.0), truncated_icosahedron_faces(4.0)
    np.testing.assert_allclose(np.linalg.norm(shape.vertices, axis=1), 4.0)
    np.testing.assert_allclose(np.linalg.norm(np.diff(shape.vertices[shape.edges], axis=1), axis=-1), 1.614, atol=1e-3)
    assert np.bincount(shape.faces).tolist() == [3] * 12 + [4] * 20
    corners = shape.vertices[shape.triangles]
    heights = np.einsum("tci,ti->tc", corners, faces.normals.numpy()[shape.faces])
    np.testing.assert_allclose(heights, faces.offsets.numpy()[shape.faces, None].repeat(3, 1), atol=1e-5)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * faces.normals.numpy()[shape.faces]).sum(1) > 0).all()


def test_the_belt_is_that_of_the_range_image() -> None:
    shape = belt(4.0)
    np.testing.assert_allclose(np.linalg.norm(shape.vertices, axis=1), 4.0)
    assert np.bincount(shape.faces).tolist() == [2] * 72
    assert len(shape.edges) == 24 * 4 + 24 * 3  # four rings and three posts a column
    corners = shape.vertices[shape.triangles]
    middles = torch.tensor(corners.mean(1) * 0.5)
    assert range_image(middles[:, None]).argmax(-1).tolist() == shape.faces.tolist()
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(1)).sum(1) > 0).all()
    assert len(shell(RangeImage.directions().numpy(), 4.0).vertices) == 96


def test_cells_of_another_reduction_are_what_is_nearest_to_their_directions() -> None:
    around = np.arange(8) * np.pi / 4
    sectors = np.stack([np.cos(around), np.sin(around), np.zeros(8)], -1)
    shape = shell(sectors, 4.0)
    np.testing.assert_allclose(np.linalg.norm(shape.vertices, axis=1), 4.0)
    corners = shape.vertices[shape.triangles]
    x, y, _ = corners.mean(1).T
    assert (np.round(np.arctan2(y, x) / (np.pi / 4)).astype(int) % 8 == shape.faces).all()
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(1)).sum(1) > 0).all()
    sides = np.arctan2(*shape.vertices[shape.edges].mean(1)[:, 1::-1].T) / (np.pi / 4) - 0.5
    lie = np.abs(sides - np.round(sides)) < 0.2  # borders run half-way between two sectors, but near the poles
    assert lie.mean() > 0.8
    assert len(shell(TruncatedIcosahedron.directions().numpy(), 4.0).vertices) == 60
    assert len(shell(TruncatedIcosahedron.directions().numpy()[::-1], 4.0).vertices) > 60, "32 others are not ours"


def test_foundations_are_left_out_and_nothing_else() -> None:
    scenery = next(iter(small_recording().sceneries.values()))
    seen = above_ground(scenery)
    assert 0.3 < len(seen["triangles"]) / len(scenery.triangles) < 1
    ground = HeightField(scenery.heights, tuple(scenery.size.tolist())).at(seen["vertices"][:, :2])
    assert (seen["vertices"][:, 2] >= ground).all() and (np.abs(seen["vertices"][:, :2]) <= scenery.size / 2).all()
    stays = (np.abs(scenery.vertices[:, :2]) < scenery.size / 2).all(1) & (scenery.vertices[:, 2] > ground)
    np.testing.assert_array_equal(seen["vertices"][stays], scenery.vertices[stays])
    shown = {tuple(triangle) for triangle in seen["triangles"].tolist()}
    assert shown == {tuple(triangle) for triangle in scenery.triangles[stays[scenery.triangles].any(1)].tolist()}


def test_without_plotly_the_page_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(UavrlError, match=r"pip install 'uavrl\[report\]'"):
        write_page(small_recording(), tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_a_page_of_no_flights_has_data() -> None:
    assert page_data(Recording({}, (), {}))["flights"] == []


# ---------------------------------------------------------------------- in a browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if CHROMIUM is None or CHROMEDRIVER is None:
        pytest.skip("needs chromium and chromedriver: apt-get install chromium chromium-driver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: pip install selenium")
    folder = tmp_path_factory.mktemp("browser")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.page_load_strategy = "none"
    flags = "headless no-sandbox disable-gpu disable-quic no-first-run disable-background-networking "
    flags += "disable-component-update disable-sync use-angle=swiftshader enable-unsafe-swiftshader "
    flags += f"window-size=700,500 user-data-dir={folder / 'profile'}"
    for flag in flags.split():
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(CHROMEDRIVER))
    try:
        driver.set_script_timeout(900)  # without a graphics card, and on a busy machine
        driver.command_executor.client_config.timeout = 1000
        write_page(small_recording(), folder / "page.html")
        driver.get((folder / "page.html").as_uri())
        ready = "return document.body && document.body.dataset.ready"
        until = time.monotonic() + 900
        while not driver.execute_script(ready):
            assert time.monotonic() < until, driver.get_log("browser")
            time.sleep(0.5)
        yield driver
    finally:
        driver.quit()


def test_a_browser_plays_the_flight_without_errors(browser: Any) -> None:
    flight = small_recording().flights[0]
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
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert not errors, errors


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
