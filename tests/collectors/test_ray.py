"""A Ray that is not there; tests/check flies with one."""

from __future__ import annotations

import sys

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase

from uavrl.collectors.ray import RayCollector
from uavrl.errors import UavrlError

ray = pytest.importorskip("ray")
HOVER = TensorDictModule(torch.zeros_like, ["observation"], ["action"])


def test_an_address_where_nobody_answers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise ConnectionError("Could not find any\nrunning Ray instance.")

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", refuse)
    told = r"collector.address=auto cannot be reached \(Could not find any running Ray instance.\): start Ray"
    with pytest.raises(UavrlError, match=told):
        RayCollector(EnvBase, HOVER, address="auto")


def test_ray_that_is_not_installed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UavrlError, match="pip install 'uavrl\\[ray\\]'"):
        RayCollector(EnvBase, HOVER)
