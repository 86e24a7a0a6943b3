"""The page shows the flight's own numbers and needs nothing from outside; a real browser plays it."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.flights import small_recording
from tests.helpers.pages import Page, unpack
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl.evaluation.recording import Recording
from uavrl.transforms import RangeImage, TruncatedIcosahedron
from uavrl.transforms.icosahedron import truncated_icosahedron_faces
from uavrl.transforms.range_image import range_image
from uavrl.viewer.flight_page import above_ground, make_page, page_data, write_page
from uavrl_onboard.pages.shapes import Shell, belt, football, shell


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
        forward, left, up, yaw_rate = np.abs(np.diff(flight.actions, axis=0)).mean(0)
        change = f"{forward:.2f} / {left:.2f} / {up:.2f} m/s (forward / left / up), {yaw_rate:.2f} rad/s (yaw rate)"
        reversals = f"{100 * (flight.summary.yaw_reversals or 0):.1f} %"
        assert list(shown["smoothness"].values()) == [change, reversals]


def test_a_flight_from_before_smoothness_was_measured_shows_none() -> None:
    replay = small_recording()
    old = replace(replay.flights[0].summary, action_change=None, yaw_reversals=None)
    page = page_data(replace(replay, flights=(replace(replay.flights[0], summary=old),)))
    assert page["flights"][0]["smoothness"] == {}


def test_a_page_of_many_flights_stays_small_and_one_of_none_has_data() -> None:
    replay = small_recording()
    many = Recording(replay.source, replay.flights * 25, replay.sceneries)
    assert len(make_page(many).encode()) < 15e6
    assert page_data(Recording({}, (), {}))["flights"] == []


def test_text_from_outside_cannot_leave_the_data() -> None:
    replay = small_recording()
    evil = Recording({"run": "</script><script>alert(1)</script>"}, replay.flights[:1], replay.sceneries)
    page = Page(make_page(evil))
    assert json.loads(page.scripts["data"])["source"] == evil.source
    assert len(page.scripts) == 4


def corners_that_turn_outwards(shape: Shell) -> np.ndarray:
    """The corners ``[T, 3, 3]`` of a shell's triangles, which lie on its sphere of 4 m."""
    np.testing.assert_allclose(np.linalg.norm(shape.vertices, axis=1), 4.0)
    corners = shape.vertices[shape.triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(1)).sum(1) > 0).all()
    return corners


def test_the_football_is_that_of_the_reduction() -> None:
    shape, faces = football(4.0), truncated_icosahedron_faces(4.0)
    np.testing.assert_allclose(np.linalg.norm(np.diff(shape.vertices[shape.edges], axis=1), axis=-1), 1.614, atol=1e-3)
    assert np.bincount(shape.faces).tolist() == [3] * 12 + [4] * 20
    corners = corners_that_turn_outwards(shape)
    heights = np.einsum("tci,ti->tc", corners, faces.normals.numpy()[shape.faces])
    np.testing.assert_allclose(heights, faces.offsets.numpy()[shape.faces, None].repeat(3, 1), atol=1e-5)


def test_the_belt_is_that_of_the_range_image() -> None:
    shape = belt(4.0)
    assert np.bincount(shape.faces).tolist() == [2] * 72
    assert len(shape.edges) == 24 * 4 + 24 * 3  # four rings and three posts a column
    corners = corners_that_turn_outwards(shape)
    middles = torch.tensor(corners.mean(1) * 0.5)
    assert range_image(middles[:, None]).argmax(-1).tolist() == shape.faces.tolist()
    assert len(shell(RangeImage.directions().numpy(), 4.0).vertices) == 96


def test_cells_of_another_reduction_are_what_is_nearest_to_their_directions() -> None:
    around = np.arange(8) * np.pi / 4
    sectors = np.stack([np.cos(around), np.sin(around), np.zeros(8)], -1)
    shape = shell(sectors, 4.0)
    corners = corners_that_turn_outwards(shape)
    x, y, _ = corners.mean(1).T
    assert (np.round(np.arctan2(y, x) / (np.pi / 4)).astype(int) % 8 == shape.faces).all()
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
    with pytest.raises(UavrlError, match=r"pip install 'uavrl-onboard\[pages\]'"):
        write_page(small_recording(), tmp_path / "page.html")
    assert not list(tmp_path.iterdir())
