"""Clouds of a simulated LiDAR, as a companion reads them from a topic of ROS 2."""

from __future__ import annotations

import time
from contextlib import closing
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")

from tests.helpers.ros2_peer import DOMAIN, LOOPBACK, until
from tests.helpers.sitl import Ground, Scripted
from uavrl.errors import UavrlError
from uavrl.sitl.faults import Faults
from uavrl.sitl.lidar_output import CloudOutput
from uavrl.sitl.sitl import Sitl
from uavrl_onboard.ros2.vehicle import Ros2Scans

ADDRESS = f"ros2://{DOMAIN}/sitl_points"
POINTS = np.random.default_rng(0).uniform(-20.0, 20.0, (131_072, 3)).astype(np.float32)
POINTS[::3] = np.nan


@pytest.fixture(autouse=True)
def by_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)


def test_a_cloud_arrives_as_it_is_with_its_misses() -> None:
    with closing(CloudOutput(ADDRESS, 0.09)) as output, Ros2Scans(ADDRESS) as scans:

        def sent_and_read() -> object:
            output.send([POINTS])
            time.sleep(0.05)
            return scans.poll(time.monotonic())

        scan = until(sent_and_read, "a cloud")
        assert scan.points.dtype == np.float32
        np.testing.assert_array_equal(scan.points, POINTS)
        assert (scan.rays, scan.misses) == (len(POINTS), int(np.isnan(POINTS[:, 0]).sum()))
        assert 0.0 <= time.monotonic() - scan.stamp < 1.0


def test_a_turn_is_sent_once_its_last_ray_has_been_cast() -> None:
    points = np.ones((100, 3), np.float32)
    with closing(CloudOutput(ADDRESS, 0.09)) as output:
        assert output.add(points, slice(0, 60), 2.0) == output.add(points, slice(60, 60), 2.0) == []
        ((when, sent),) = output.add(points, slice(60, 100), 2.0)
        assert when == pytest.approx(2.09)
        points[:] = np.nan  # the next turn begins
        assert (sent == 1.0).all()
        assert output.add(points, slice(100, 100), 2.0) == []
        assert len(output.whole(points, 3.0)) == 1


def test_another_node_publishes_to_the_same_topic(caplog: pytest.LogCaptureFixture) -> None:
    with closing(CloudOutput(ADDRESS, 0.09)) as output, Ros2Scans(ADDRESS) as scans:

        def told() -> bool:
            output.send([POINTS[:9]])
            output.send_as_another([POINTS[:9]])
            time.sleep(0.05)
            scans.poll(time.monotonic())
            assert output.add(POINTS[:9], slice(0, 3), 0.0) == []  # time goes on
            time.sleep(0.05)
            return any("Two nodes publish" in record.getMessage() for record in caplog.records)

        until(told, "a warning")


def test_the_simulator_publishes_ten_turns_in_a_second() -> None:
    class Room(Scripted):
        last_firing = 0.0998

    ground = Ground()
    with closing(ground), Ros2Scans(ADDRESS) as scans:
        sitl = Sitl(Room(), ADDRESS, ground.addresses[1], patience=2.0)  # type: ignore[arg-type]
        seen, hear = list[float](), sitl._hear_within

        def hear_within(seconds: float) -> None:
            if (scan := scans.poll(time.monotonic())) is not None:
                seen.append(float(np.linalg.norm(scan.points, axis=1).mean()))
            hear(seconds)

        sitl._hear_within = hear_within  # type: ignore[method-assign]
        with pytest.raises(UavrlError, match="No companion took control"):
            sitl.run()
        assert ground.packets() == []
    assert 2 <= len(seen) <= 21
    assert all(later - sooner > 0.05 for sooner, later in pairwise(seen)), "each is of its own turn"


def test_clouds_have_no_product_byte() -> None:
    with pytest.raises(UavrlError, match=r"faults.product is a byte of packets, and the clouds of ROS 2 have none"):
        Sitl(Scripted(), ADDRESS, faults=Faults(product=33))  # type: ignore[arg-type]
