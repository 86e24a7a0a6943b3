"""A film shows the flight from behind the vehicle."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.flights import small_recording
from uavrl.errors import UavrlError
from uavrl.flying.recording import RecordedFlight, Scenery
from uavrl.reporting.flight_video import FRAME_RATE, Camera, moment, write_video


@pytest.fixture(scope="module")
def shown() -> tuple[RecordedFlight, Scenery]:
    """Three moments of a flight: six pictures, and a second of the last one."""
    flight = small_recording().flights[0]
    first = {
        n: getattr(flight, n)[:3] for n in ("times", "positions", "attitudes", "velocities", "distances", "planes")
    }
    return replace(flight, **first), small_recording().scenery(flight)


def test_the_vehicle_is_in_the_middle_and_the_sky_above(shown: tuple[RecordedFlight, Scenery]) -> None:
    camera = Camera(*shown, size=(160, 90))
    try:
        image = camera.render(0.1).astype(int)
        assert image.shape == (90, 160, 3)
        red, green, blue = image[30:80, 50:110].reshape(-1, 3).T
        assert ((blue > red + 60) & (blue > green + 20)).sum() > 20  # the rotors
        assert (image[0] >= [140, 180, 210]).all(1).mean() > 0.5
        assert (camera.render(-1.0) == camera.render(0.0)).all() and (camera.render(99.0) == camera.render(0.2)).all()
    finally:
        camera.close()
        camera.close()


def test_what_is_told_is_the_newest_moment(shown: tuple[RecordedFlight, Scenery]) -> None:
    assert [moment(shown[0], time) for time in (-1.0, 0.0, 0.05, 0.1, 9.0)] == [0, 0, 0, 1, 2]


def test_a_film_has_the_frames_of_the_flight(shown: tuple[RecordedFlight, Scenery], tmp_path: Path) -> None:
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("imageio_ffmpeg")
    write_video(*shown, tmp_path / "film.mp4")
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    with imageio.get_reader(tmp_path / "film.mp4") as film:
        about = film.get_meta_data()
        assert about["size"] == (640, 360) and about["fps"] == FRAME_RATE
        pictures = [np.asarray(picture) for picture in film]
    assert len(pictures) == 4 + FRAME_RATE
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 30


def test_a_file_that_is_no_film_is_refused(shown: tuple[RecordedFlight, Scenery], tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    with pytest.raises(UavrlError, match=r"name a film that ends in \.mp4"):
        write_video(*shown, tmp_path / "film.xyz")
    assert not list(tmp_path.iterdir())


def test_without_imageio_a_film_says_what_to_install(
    shown: tuple[RecordedFlight, Scenery], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UavrlError, match=r"pip install 'uavrl\[video\]'"):
        write_video(*shown, tmp_path / "film.mp4")
