"""Another LiDAR than that of the training: which cells it never sees, and what is said about them."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf

from uavrl import load_policy
from uavrl.config import compose, resolve, validate
from uavrl.config.settings import EvaluateConfig
from uavrl.envs.guarding import looks_around
from uavrl.envs.sensors import SENSORS, LidarSensor, lidar_sensor
from uavrl.errors import UavrlError
from uavrl.evaluation.field_of_view import (
    check_field_of_view,
    trained_sensor,
    unseen_cells,
    warn_beyond_rows,
    with_trained_view,
)
from uavrl.evaluation.overrides import with_overrides
from uavrl.transforms import RangeImage

UNSEEN = {"vlp16": 0, "os0_32": 0, "os0_128": 0, "os1_64": 0, "xt32": 0, "mid360": 0, "rplidar": 48, "d435": 51}
"""Of the 72 cells of a range image."""


def perception(*overrides: str) -> dict[str, Any]:
    return validate(compose("perception=range_image", *overrides, name="evaluate"), EvaluateConfig).perception


@pytest.mark.parametrize(
    ("azimuth", "steps", "around"),
    [
        *(((-180.0, 180.0), 30, True), ((-180.0, 180.0), 3, True), ((-180.0, 180.0), 360, True)),
        *(((-170.0, 170.0), 340, False), ((-45.0, 45.0), 4, False), ((-180.0, 180.0), 1, False)),
    ],
)
def test_a_lidar_looks_around_if_no_side_is_missing(azimuth: tuple[float, float], steps: int, around: bool) -> None:
    device = LidarSensor("mine", elevations=(-5.0, 5.0), azimuth_steps=steps, azimuth=azimuth)
    assert looks_around(device) == around


def test_the_cells_that_each_sensor_never_sees_are_counted() -> None:
    seen = perception()
    assert {name: len(unseen_cells(seen, name)[0]) for name in SENSORS} == UNSEEN
    unseen, directions = unseen_cells(seen, "rplidar")
    assert all(abs(directions[cell][2]) > 0.1 for cell in unseen)  # the rows above and below its plane
    behind, directions = unseen_cells(seen, "d435")
    assert all(directions[cell][0] < 0.7 for cell in behind)


def test_a_trained_policy_flies_with_a_sensor_that_misses_cells_only_if_asked(caplog: pytest.LogCaptureFixture) -> None:
    rplidar = perception("env.lidar=rplidar")
    with pytest.raises(UavrlError) as refused:
        check_field_of_view(rplidar, "vlp16")
    assert str(refused.value) == (
        "The LiDAR rplidar never sees 48 of the 72 cells that the policy was trained to read with vlp16 (at elevations "
        "from -10 to 10 degrees), so it would take them for free: choose another env.lidar, train a policy for this "
        "one with uavrl-train env.lidar=rplidar, or fly nevertheless with allow_unseen=true."
    )
    with caplog.at_level(logging.WARNING):
        assert check_field_of_view(rplidar, "vlp16", allowed=True) == 48
        assert check_field_of_view(rplidar) == 48  # a controller that was not trained
    assert (
        caplog.messages
        == [
            "The LiDAR rplidar never sees 48 of the 72 cells (at elevations from -10 to 10 degrees); they read as free."
        ]
        * 2
    )
    assert check_field_of_view(rplidar, "rplidar") == 0  # it was trained without these cells
    assert check_field_of_view(perception("env.lidar=os0_32"), "vlp16") == 0
    with pytest.raises(UavrlError, match=r"d435 never sees 51 .* from 60 to 300 degrees to the left of straight ahead"):
        check_field_of_view(perception("env.lidar=d435"), "vlp16")


@pytest.mark.parametrize(
    ("flown", "trained_with", "view"),
    [
        ([], "vlp16", None),  # its own
        (["env.lidar=mid360"], "mid360", None),
        (["env.lidar=mid360"], "vlp16", (-180, 180, -15, 15)),
        (["env.lidar=mid360", "perception.grid.elevation=[-7,52]"], "vlp16", (-180, 180, -15, 52)),  # all its rows
        ([], "d435", (-43.5, 43.5, -29, 29)),
        (["env.lidar=os0_32"], None, (-180, 180, -15, 15)),  # a controller that was not trained: its rows
        (["env.lidar=os0_32", "perception=truncated_icosahedron"], None, None),
        (["env.lidar=os0_32", "perception=truncated_icosahedron"], "vlp16", (-180, 180, -15, 15)),
    ],
)
def test_a_policy_reads_what_its_own_sensor_could_have_seen(flown: list[str], trained_with: Any, view: Any) -> None:
    seen = with_trained_view(perception(*flown), trained_with)
    assert seen["lidar"].trained_view == view
    assert {**seen, "lidar": None} == {**perception(*flown), "lidar": None}


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["env.lidar=mid360"], ["mid360 sees from -7 to 52 degrees, and the rows of the cells reach from -15 to 15: "]),
        (["env.lidar=os0_32"], ["perception.grid.elevation=[-45,45] gives all of it rows of its own."]),
        (["env.lidar=mid360", "perception.grid.elevation=[-7,52]"], []),
        (["env.lidar=xt32"], []),
        (["env.lidar=os0_32", "perception=truncated_icosahedron"], []),
    ],
)
def test_a_training_is_told_what_its_rows_do_not_reach(
    overrides: list[str], told: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        warn_beyond_rows(perception(*overrides))
    assert len(caplog.messages) == len(told) and all(words in caplog.text for words in told)


def test_under_a_ceiling_a_sensor_that_looks_up_shows_what_the_sensor_of_the_training_does() -> None:
    """The ceiling is 2 m above the flight level, and in the Ouster's view."""
    policy = load_policy("best")
    changes = ("env=rooms", "randomize=none", "perception.lidar.range_noise=0", "perception.lidar.min_range=0")
    cells: dict[str, torch.Tensor] = {}
    for sensor in ("vlp16", "os0_128"):
        env = policy.make_env(*changes, f"env.lidar={sensor}", num_uavs=4, guards="none", keep_cloud=True)
        begun = env.reset()
        cells[sensor], cloud = begun["faces"], begun["point_cloud"]
    assert (cells["os0_128"] - cells["vlp16"]).abs().quantile(0.9) < 0.1
    assert ((RangeImage.reduced(cloud) - cells["vlp16"]).abs() > 1.0).sum() >= 10, "as all points would show it"


def test_rays_that_the_cells_do_not_read_do_not_count_as_seen(tmp_path: Path) -> None:
    """Of beams at -20, 0 and 20 degrees a policy of a VLP-16 reads those ahead alone."""
    (tmp_path / "three.yaml").write_text("elevations: [-20, 0, 20]\nazimuth_steps: 720\n")
    with pytest.raises(UavrlError, match="The LiDAR three never sees 48 of the 72 cells"):
        check_field_of_view(perception(f"env.lidar={tmp_path / 'three.yaml'}"), "vlp16")


def test_a_lidar_that_reaches_less_far_than_the_cells_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "short.yaml").write_text("like: vlp16\nmax_range: 1\n")
    short, camera = f"env.lidar={tmp_path / 'short.yaml'}", perception("env.lidar=d435", "perception.lidar.max_range=3")
    with caplog.at_level(logging.WARNING):
        assert check_field_of_view(perception(short), "vlp16") == 0
        check_field_of_view(camera, "vlp16", allowed=True)
        check_field_of_view(perception(short), perception(short)["lidar"].sensor)  # it was trained so
        check_field_of_view(perception("env.lidar=mid360"), "vlp16")
    told = [message for message in caplog.messages if "reaches" in message]
    assert told == [
        f"The LiDAR {name} m, and the policy reads its cells up to 4 m: obstacles that are farther away read as free."
        for name in ("short reaches 1", "d435 reaches 3")
    ]


def test_a_run_keeps_its_sensor_and_its_speed_in_another_environment() -> None:
    run = resolve(compose("preset=dagger", "env.lidar=mid360", "env.max_speed=4", "run_dir=x"))
    assert run.perception.lidar.sensor == trained_sensor(run) == "mid360" and "lidar" not in run.env
    assert run.perception.max_speed == run.env.max_speed == 4.0
    for told, sensor, speed in (
        (["env=dynamic"], "mid360", 4.0),
        (["env=dynamic", "env.lidar=xt32", "env.max_speed=6"], "xt32", 6.0),
        (["env.max_speed=3"], "mid360", 3.0),
    ):
        changed = validate(with_overrides(run, compose(*told, name="evaluate"), told))
        assert (changed.perception["lidar"].sensor, changed.env["max_speed"]) == (sensor, speed)
        assert changed.perception["max_speed"] == 4.0  # what the network reads as 1


def test_a_run_keeps_the_settings_of_an_own_sensor_and_not_its_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("elevations: [-10, 0, 10]\nazimuth_steps: 90\n")
    run = OmegaConf.create(OmegaConf.to_yaml(resolve(compose(f"env.lidar={file}", "run_dir=x"))))
    file.unlink()
    assert lidar_sensor(trained_sensor(run)).num_rays == 270
    assert validate(run).perception["lidar"].device.name == "mine"


def test_an_example_describes_an_own_sensor_in_twenty_lines() -> None:
    file = Path(__file__).parents[2] / "examples/lidar/qt64.yaml"
    assert len(file.read_text(encoding="utf-8").splitlines()) <= 20
    sensor = lidar_sensor(str(file))
    assert (sensor.num_rays, sensor.field_of_view) == (38_400, (-180.0, 180.0, -52.1, 52.1))


@pytest.mark.parametrize(("speed", "radius"), [(1, 4.0), (2, 4.0), (4, 4.0), (5, 5.0), (6, 6.0)])
def test_the_cells_reach_as_far_as_the_speed_needs(speed: float, radius: float) -> None:
    found = perception(f"env.max_speed={speed}")
    assert (found["radius"], found["lidar"].max_range, found["max_speed"]) == (radius, radius, speed)
    assert perception(f"env.max_speed={speed}", "perception.radius=9")["radius"] == 9.0
