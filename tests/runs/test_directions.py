"""A run keeps the directions of a LiDAR of one's own: it flies wherever its folder is, and notices another file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from tests.helpers.exported import policy_folder
from tests.helpers.runs import small_config
from uavrl.config import resolve, validate
from uavrl.envs.sensors import lidar_sensor
from uavrl.evaluation.field_of_view import trained_sensor
from uavrl.export.export import export_policy
from uavrl.runs.config import fingerprint, read_config
from uavrl.training.run import create_run

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


def test_a_run_that_was_moved_has_its_rays(own: Path, tmp_path: Path) -> None:
    run = create_run(resolve(small_config(tmp_path / "run", f"env.lidar={own / 'mine.yaml'}")))
    expected = rays_of(run)
    gone(own)
    moved = run.rename(tmp_path / "moved")
    np.testing.assert_array_equal(rays_of(moved), expected)
    assert expected.shape == (270, 3)


def test_an_exported_policy_has_them_too(own: Path, tmp_path: Path) -> None:
    policy = policy_folder(tmp_path / "own", f"env.lidar={own / 'mine.yaml'}", "algo.hidden=[4]")
    export_policy(policy, None, tmp_path / "exported")
    gone(own)
    moved = (tmp_path / "exported").rename(tmp_path / "moved")
    assert rays_of(moved).shape == (270, 3)
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
