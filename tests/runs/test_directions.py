"""A run keeps the directions of a LiDAR of one's own: it flies wherever its folder is, and notices another file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from tests.helpers.exported import policy_folder
from tests.helpers.runs import small_config
from uavrl.config import resolve, validate
from uavrl.envs import sensors
from uavrl.envs.sensors import lidar_sensor
from uavrl.errors import UavrlError
from uavrl.evaluation.field_of_view import trained_sensor
from uavrl.export.export import export_policy
from uavrl.runs.config import fingerprint, read_config
from uavrl.runs.directions import KEY
from uavrl.training.run import create_run, train
from uavrl.training.sweep import require_same_run

RAYS = np.array([[azimuth, elevation] for azimuth in range(-180, 180, 4) for elevation in (-10, 0, 10)], float)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "lidar").mkdir()
    np.savetxt(tmp_path / "lidar" / "rays.csv", RAYS, delimiter=",")
    (tmp_path / "lidar" / "mine.yaml").write_text("directions: rays.csv\nmax_range: 30\n")
    return tmp_path / "lidar"


def rays_of(folder: Path) -> np.ndarray:
    config = read_config(folder)
    validate(config)  # also builds the LiDAR
    return lidar_sensor(trained_sensor(config)).rays.directions[0]


def gone(own: Path) -> None:
    for file in own.iterdir():
        file.unlink()
    sensors.rays_of.cache_clear()


def test_a_run_that_was_moved_has_its_rays(own: Path, tmp_path: Path) -> None:
    run = create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))
    expected = rays_of(run)
    gone(own)
    moved = run.rename(tmp_path / "moved")
    np.testing.assert_array_equal(rays_of(moved), expected)
    assert expected.shape == (270, 3)
    assert "directions: lidar_directions.csv\n" in (moved / "config.yaml").read_text(), "no path of this machine"


@pytest.mark.parametrize("name", ["RAYS.NPY", "lidar_directions.npy"])
def test_so_has_one_whose_rays_lay_in_its_folder(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    with (folder / name).open("wb") as file:
        np.save(file, RAYS)
    (folder / "mine.yaml").write_text(f"directions: {name}\n")
    run = create_run(resolve(small_config(folder, f"env.lidar={folder / 'mine.yaml'}")))
    (run / "mine.yaml").unlink()
    (run / "RAYS.NPY").unlink(missing_ok=True)
    sensors.rays_of.cache_clear()
    assert rays_of(run.rename(tmp_path / "moved")).shape == (270, 3)


def test_rays_that_vanish_before_a_run_begins_are_named(own: Path, tmp_path: Path) -> None:
    config = resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}"))
    gone(own)
    with pytest.raises(UavrlError, match=r"rays\.csv, are no longer there: put the file back"):
        create_run(config)


def test_a_folder_of_links_is_read_and_nothing_is_written_through_them(own: Path, tmp_path: Path) -> None:
    """The cache of the Hugging Face Hub holds each file as a link to a folder beside it."""
    run = create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))
    blob = (run / "lidar_directions.csv").rename(tmp_path / "blob")
    (run / "lidar_directions.csv").symlink_to(blob)
    gone(own)
    assert rays_of(run).shape == (270, 3)
    with pytest.raises(UavrlError, match=r"lidar_directions\.csv is a link that leads out of"):
        train(read_config(run), run, resume=True)


def test_a_file_of_the_users_is_not_overwritten(own: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    precious = tmp_path / "run" / "lidar_directions.csv"
    precious.write_text("precious")
    with pytest.raises(UavrlError, match=r"lidar_directions\.csv would be overwritten by .*rays\.csv: choose another"):
        create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))
    assert precious.read_text() == "precious"
    precious.write_bytes((own / "rays.csv").read_bytes())
    assert (
        rays_of(create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))).shape[0] == 270
    )


def test_a_sensor_keeps_its_rays_when_its_file_changes(own: Path) -> None:
    before = lidar_sensor(str(own / "mine.yaml"))
    np.savetxt(own / "rays.csv", RAYS[:3], delimiter=",")
    after = lidar_sensor(str(own / "mine.yaml"))
    assert (before.num_rays, after.num_rays) == (270, 3) and before != after


def test_another_sweep_is_told_that_the_rays_are_others(own: Path, tmp_path: Path) -> None:
    chosen = f"env.lidar={own / 'mine.yaml'}"
    run = create_run(resolve(small_config(tmp_path / "run", chosen)))
    np.savetxt(own / "rays.csv", RAYS[:3], delimiter=",")
    with pytest.raises(UavrlError, match=r"other settings \(perception\.lidar\.[a-z.]* names a file with other rays\)"):
        require_same_run(run, resolve(small_config(tmp_path / "run", chosen)))


def test_a_file_that_never_ends_is_not_read(own: Path, tmp_path: Path) -> None:
    run = create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))
    (run / "lidar_directions.csv").unlink()
    (run / "lidar_directions.csv").symlink_to("/dev/zero")
    with pytest.raises(UavrlError, match=r"lidar_directions\.csv must be a file, not a folder or a device"):
        rays_of(run)
    for file in ("/dev/zero", "/dev/null\0"):
        config = resolve(small_config(tmp_path / "other", f"env.lidar={own / 'mine.yaml'}"))
        OmegaConf.update(config, KEY, file)
        assert len(fingerprint(config)) == 64


def test_a_copy_that_is_gone_is_not_looked_for_elsewhere(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))
    (run / "lidar_directions.csv").rename(own / "lidar_directions.csv")
    monkeypatch.chdir(own)
    with pytest.raises(
        UavrlError, match=rf"{re.escape(str(run))}/lidar_directions\.csv cannot be read \(No such file or directory\)"
    ):
        rays_of(run)


def test_an_exported_policy_has_them_too(own: Path, tmp_path: Path) -> None:
    policy = policy_folder(tmp_path / "own", f"env.lidar={own / 'mine.yaml'}", "algo.hidden=[4]")
    export_policy(policy, None, tmp_path / "exported")
    gone(own)
    moved = (tmp_path / "exported").rename(tmp_path / "moved")
    assert rays_of(moved).shape == (270, 3)
    assert "directions: lidar_directions.csv\n" in (moved / "config.yaml").read_text()
    again = tmp_path / "again"
    export_policy(moved, None, again)
    assert rays_of(again).shape == (270, 3)


def test_the_content_of_the_file_counts_and_not_its_place(own: Path, tmp_path: Path) -> None:
    chosen = f"env.lidar={own / 'mine.yaml'}"
    config = resolve(small_config(tmp_path / "run", chosen))
    before = fingerprint(config)
    run = create_run(config)
    assert fingerprint(config) == fingerprint(read_config(run)) == before
    np.savetxt(own / "rays.csv", RAYS[:3], delimiter=",")
    assert fingerprint(resolve(small_config(tmp_path / "run", chosen))) != before
    assert len(rays_of(run)) == 270, "the run keeps its own"
    assert lidar_sensor(str(own / "mine.yaml")).num_rays == 3, "a file is read again when it has changed"


@pytest.mark.parametrize("sensor", ["vlp16", "xt32"])
def test_other_configurations_stay_as_they_are(sensor: str, tmp_path: Path) -> None:
    config = resolve(small_config(tmp_path / "run", f"env.lidar={sensor}"))
    before = OmegaConf.to_yaml(config.perception)
    run = create_run(config)
    assert OmegaConf.to_yaml(read_config(run).perception) == before
    assert not list(run.glob("lidar_directions*"))
