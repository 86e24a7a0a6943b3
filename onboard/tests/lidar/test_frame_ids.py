"""The frames of clouds that a policy can read."""

from __future__ import annotations

import pytest

from uavrl_onboard.lidar.frame_ids import CloudFrame


@pytest.mark.parametrize(
    "name", ["camera_depth_optical_frame", "/camera_color_optical_frame", "zed_left_camera_optical"]
)
def test_a_camera_s_axes_are_refused(name: str) -> None:
    told = CloudFrame().refusal(name)
    assert told.startswith(f"they are in the frame {name.strip('/')}, a camera's, whose z points ahead (REP 103): ")


@pytest.mark.parametrize("name", ["camera_link", "velodyne", "", "optical_lidar"])
def test_other_frames_are_taken(name: str) -> None:
    assert CloudFrame().refusal(name) == ""
