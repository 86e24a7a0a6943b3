"""Errors that the user can mend, also out of another process."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from uavrl.errors import FlyingEnded, MissingExtra, OtherFormat, UavrlError
from uavrl.runs.checkpoint import DamagedCheckpoint

ERRORS = [
    UavrlError("seed must be a number."),
    MissingExtra("pybullet", "sim"),
    OtherFormat("a.csv", "column"),
    FlyingEnded("killed"),
    DamagedCheckpoint(Path("a"), "it is empty"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_comes_whole_out_of_another_process(error: UavrlError) -> None:
    """One that pickle cannot make again breaks the pool of a suite, which then seems to have been killed."""
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error) and str(again) == str(error) and vars(again) == vars(error)
