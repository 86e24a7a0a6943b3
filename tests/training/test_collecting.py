"""Which collectors a run takes."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import open_dict
from torchrl.collectors import Collector

from tests.helpers.configs import composed
from tests.helpers.runs import small_config
from uavrl.configs import to_dataclass
from uavrl.errors import UavrlError
from uavrl.training.factory import collector_class
from uavrl.training.run import create_run, resume_config
from uavrl.training.sync_collector import SyncCollector


class Plain(Collector):
    """One of TorchRL's as it is."""


class Mine(Collector):
    """One of TorchRL's with what a run asks for."""

    flies_elsewhere = False
    start_anew = SyncCollector.start_anew
    wind_down = SyncCollector.wind_down


def chosen(name: str) -> type:
    config = composed()
    config.collector._target_ = f"{__name__}.{name}"
    config.packages = ["tests"]
    return collector_class(to_dataclass(config))


def test_one_that_has_what_a_run_asks_for_is_taken_and_another_is_told_what_it_lacks() -> None:
    assert chosen("Mine") is Mine
    with pytest.raises(UavrlError, match="Plain lacks flies_elsewhere, start_anew, wind_down: subclass one of them"):
        chosen("Plain")


def test_the_address_of_a_cluster_is_not_taken_from_a_run_folder(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "collector=ray", "collector.address=10.0.0.1:6379")
    run_dir = create_run(config)
    with open_dict(config):
        config.collector.address = "auto"
    assert resume_config(run_dir, config, []).collector.address is None
    assert resume_config(run_dir, config, ["collector.address"]).collector.address == "auto"
