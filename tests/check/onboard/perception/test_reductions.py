"""The reductions in numpy against those in PyTorch, on many clouds."""

from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.numpy_reductions import PAIRS, check_clouds


@pytest.mark.parametrize("statistic", ["face", "range", "proximity"])
@pytest.mark.parametrize(("ours", "name"), PAIRS)
def test_ten_thousand_clouds_reduce_as_in_torch(ours: Any, name: Any, statistic: str) -> None:
    check_clouds(ours, name, statistic, 10_000)
