"""What a run needs of memory is told before it begins."""

from __future__ import annotations

import pytest

from tests.helpers.configs import composed
from uavrl.cli.memory import require_memory
from uavrl.config import validate
from uavrl.errors import UavrlError


def test_an_ordinary_training_fits_into_a_gigabyte_and_ten_times_its_buffer_does_not() -> None:
    require_memory(validate(composed()), memory=1e9)
    large = validate(composed("config", "buffer.capacity=10000000"))
    with pytest.raises(UavrlError, match=r"about 2 GB of memory, 2 GB of it for buffer\.capacity=10000000"):
        require_memory(large, memory=1e9)
