"""A mark for tests that measure this machine: its clock, as a sensor or an autopilot goes by it, or its memory.

It is for those, too, that wait for a browser. A machine that has much else to do fails them for a while, and a fault
fails them each time: they get three tries.
"""

from __future__ import annotations

import pytest

measured = pytest.mark.flaky(reruns=2, reruns_delay=3)
