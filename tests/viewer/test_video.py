"""A video shows the episode's own valley, vehicle and goal; what cannot be drawn is refused in one sentence."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.helpers.flights import small_recording
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl.evaluation.recording import Recording
from uavrl.viewer import video
from uavrl.viewer.colours import GOAL
from uavrl.viewer.scene import Body, BodyPose, SceneRenderer, View, rgb
from uavrl.viewer.video import FORMATS, Film, Format, title, write_video
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.pages.shapes import BODY

SIZE = (96, 64)


@pytest.fixture(scope="module")
def recording() -> Recording:
    both = small_recording()
    return replace(both, flights=both.flights[:1])


@pytest.fixture(scope="module")
def scene(recording: Recording) -> SceneRenderer:
    square = Mesh([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], [[0, 1, 2], [0, 2, 3]])
    return SceneRenderer(recording.scenery(recording.flights[0]), [Body.of([(square, "#0000ff")])])


@pytest.mark.parametrize("width", [None, 12.0])
def test_a_point_on_the_ray_of_a_pixel_is_seen_in_that_pixel(width: float | None) -> None:
    view = View(np.array([1.0, 2.0, 3.0]), np.array([4.0, 1.0, 2.5]), width=width)
    columns, rows = np.array([0, 50, 95]), np.array([63, 20, 0])
    origins, directions = view.rays(columns, rows, SIZE)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-6)
    pixels, distances = view.pixels(origins + 7 * directions, SIZE)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], 1), atol=1e-3)
    np.testing.assert_allclose(distances, 7.0, rtol=1e-5)
    assert (view.pixels(view.eye - 5 * (view.target - view.eye)[None], SIZE)[1] <= 0).all()


def test_what_is_seen_straight_below_is_the_ground_of_the_valley(recording: Recording, scene: SceneRenderer) -> None:
    place = recording.scenery(recording.flights[0])
    start = recording.flights[0].positions[0]
    ground = HeightField(place.heights, (float(place.size[0]), float(place.size[1]))).at(start[None, :2])[0]
    below = scene.blocked(start, np.array([[0.0, 0.0, -1.0]]))[0]
    assert below == pytest.approx(start[2] - ground, abs=0.02)


def test_a_body_hides_what_is_behind_it_and_not_what_is_in_front(recording: Recording, scene: SceneRenderer) -> None:
    start = recording.flights[0].positions[0].astype(float)
    view = View(start, start - np.array([0.0, 0.0, 1.0]), up=(1.0, 0.0, 0.0))  # down at the ground
    facing_up = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    empty, depth = scene.picture(view, [], SIZE)
    above, near = scene.picture(view, [BodyPose(0, start - np.array([0, 0, 1.5]), facing_up)], SIZE)
    under, same = scene.picture(view, [BodyPose(0, start - np.array([0, 0, 50.0]), facing_up)], SIZE)
    middle = np.s_[28:36, 44:52]
    np.testing.assert_allclose(near[middle], 1.5, rtol=0.01)
    assert (above[middle][..., 2] > 0.5).all() and (above[middle][..., :2] < 0.01).all()
    np.testing.assert_array_equal(empty, under)
    np.testing.assert_array_equal(depth, same)


def test_the_vehicle_is_in_the_middle_and_the_film_as_long_as_the_episode(recording: Recording) -> None:
    film = Film(recording, Format((320, 192), 2))
    pictures = list(film)
    flight = recording.flights[0]
    assert len(pictures) == len(film) == np.ceil(flight.times[-1] * 2) + 2  # and a second of the last one
    for picture in pictures:
        assert picture.shape == (192, 320, 3) and picture.dtype == np.uint8
        middle = picture[96:160, 128:192].reshape(-1, 3).astype(float)
        assert np.abs(middle - 255 * rgb(BODY)).max(1).min() < 60, "rotors"
    np.testing.assert_array_equal(pictures[-1], pictures[-2])
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50


def test_the_goal_is_tinted_where_it_is(recording: Recording) -> None:
    flight = recording.flights[0]
    radius = recording.scenery(flight).goal[0]
    near = flight.goal + np.array([2.5 * radius, 0.0, 0.0])  # the episode is moved to in front of its goal
    turned = np.tile([0.0, 0.0, 1.0, 0.0], (len(flight.times), 1))
    moved = replace(flight, positions=np.tile(near, (len(flight.times), 1)).astype(np.float32), attitudes=turned)
    picture = next(iter(Film(replace(recording, flights=(moved,)), Format((320, 192), 2)))).astype(float) / 255
    far = replace(moved, goal=flight.goal - np.array([0, 0, 500.0]))
    without = next(iter(Film(replace(recording, flights=(far,)), Format((320, 192), 2)))).astype(float) / 255
    tint, towards = picture - without, rgb(GOAL) - without
    wall = np.s_[60:70, 150:170]
    assert (np.sign(tint[wall]) == np.sign(towards[wall])).mean() > 0.9 and np.abs(tint[wall]).mean() > 0.05


def test_a_gif_plays_in_real_time(recording: Recording, tmp_path: Path) -> None:
    write_video(recording, tmp_path / "flight.gif", progress=False)
    assert [path.name for path in tmp_path.iterdir()] == ["flight.gif"]
    with Image.open(tmp_path / "flight.gif") as gif:
        assert gif.size == FORMATS[".gif"].size
        times = []
        for frame in range(gif.n_frames):
            gif.seek(frame)
            times.append(gif.info["duration"] / 1000)
    rate = FORMATS[".gif"].rate
    assert sum(times) == pytest.approx(recording.flights[0].times[-1] + 1.0, abs=1.5 / rate)


def test_an_mp4_is_a_film_that_browsers_play_in_real_time(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="needs av: pip install 'uavrl[video]'")
    rows, columns = np.mgrid[:64, :96]
    pictures = [np.stack([2 * columns, 3 * rows, np.full_like(rows, 8 * n)], -1).astype(np.uint8) for n in range(30)]
    video._write_mp4(iter(pictures), tmp_path / "flight.partial", Format(SIZE, 15))
    with av.open(str(tmp_path / "flight.partial")) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == SIZE and float(stream.average_rate) == 15
        assert float(stream.duration * stream.time_base) == pytest.approx(2.0)
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(stream)]
    assert len(frames) == len(pictures)
    assert all(np.abs(a.astype(int) - b).mean() < 6 for a, b in zip(frames, pictures, strict=True))


def test_the_title_names_policy_training_valley_and_task(recording: Recording) -> None:
    flight = recording.flights[0]
    valley = f"valley {flight.summary.world_seed}, task 1"
    assert title(recording, flight) == f"straight, {valley}"
    trained = replace(recording, source={"run": "mine", "policy": "x", "training_steps": 100_008})
    assert title(trained, flight) == f"mine, 100,008 training steps, {valley}"


@pytest.mark.parametrize(("name", "missing"), [("a.mp4", "av"), ("a.gif", "PIL")])
def test_a_missing_library_is_named_with_its_extra(
    name: str, missing: str, recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(UavrlError, match=rf"needs {missing}, which is not installed: pip install 'uavrl\[video\]'"):
        write_video(recording, tmp_path / name, progress=False)
    assert not list(tmp_path.iterdir())


def test_several_episodes_and_other_files_are_refused(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match=r"A video shows one episode, and the recording has 2: record one with task="):
        write_video(small_recording(), tmp_path / "a.gif")
    with pytest.raises(UavrlError, match=r"ends in \.mp4 or \.gif, got .*a\.avi"):
        write_video(recording, tmp_path / "a.avi")
    assert not list(tmp_path.iterdir())
