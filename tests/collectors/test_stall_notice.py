"""A collector that waits says why."""

from __future__ import annotations

import logging
import time

import pytest

from tests.helpers.measured import measured
from uavrl.collectors.stall_notice import StallNotice


@measured
def test_a_long_silence_is_explained_once_and_a_short_one_never(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with StallNotice(lambda: "Waiting for an episode.", seconds=0.3) as stall_notice:
        for said in ([], ["Waiting for an episode."], ["Waiting for an episode."] * 2):
            assert caplog.messages == said
            for _ in range(10 if not said else 0):
                time.sleep(0.05)
                stall_notice.reset()
            assert caplog.messages == said
            stall_notice.reset()
            time.sleep(0.6)
    time.sleep(0.4)
    assert len(caplog.messages) == 3
