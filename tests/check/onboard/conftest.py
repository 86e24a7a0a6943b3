"""What flights over loopback share."""

from __future__ import annotations

from pathlib import Path

import pytest

from uavrl.evaluation.policies import PACKAGED
from uavrl.export.export import export_policy


@pytest.fixture(scope="session")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packaged ``best`` as ``uavrl-export`` writes it, without guards: what fails is then the flight's own."""
    folder = tmp_path_factory.mktemp("exported") / "best"
    export_policy(PACKAGED / "best", None, folder)
    return folder
