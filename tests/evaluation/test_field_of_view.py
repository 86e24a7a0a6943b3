"""Another LiDAR than that of the training: which cells it never sees, and what is said about them."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from uavrl.config import compose, resolve, validate
from uavrl.config.settings import EvaluateConfig
from uavrl.envs.sensors import SENSORS, lidar_sensor
from uavrl.errors import UavrlError
from uavrl.evaluation.field_of_view import check_field_of_view, trained_sensor, unseen_cells
from uavrl.evaluation.overrides import with_overrides

UNSEEN = {"vlp16": 0, "os0_32": 0, "os0_128": 0, "os1_64": 0, "xt32": 0, "mid360": 0, "rplidar": 48, "d435": 51}
"""Of the 72 cells of a range image."""


def perception(*overrides: str) -> dict[str, Any]:
    return validate(compose("perception=range_image", *overrides, name="evaluate"), EvaluateConfig).perception


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
