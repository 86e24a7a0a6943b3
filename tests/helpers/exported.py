"""Exported policies that have learned nothing, and damaged copies of their contracts."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf

from uavrl.config import compose, resolve, validate
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import saved_sizes
from uavrl.export.export import export_policy
from uavrl.losses.networks import make_actor
from uavrl.runs.weights import POLICY
from uavrl_onboard.policy.policy import Policy


def policy_folder(folder: Path, *overrides: str) -> Path:
    """A policy on its own, as drawn: what ``uavrl-export`` takes."""
    config = resolve(compose("run_dir=here", *overrides))
    settings = validate(config)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        actor = make_actor(settings, saved_sizes(settings))
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
    POLICY.save(folder, actor.state_dict(), {})
    return folder


def exported(folder: Path, *overrides: str) -> Path:
    """The same with ``contract.json`` and ``policy.onnx``."""
    export_policy(policy_folder(folder / "own", *overrides), None, folder / "exported")
    return folder / "exported"


def edit_contract(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    terms = json.loads((folder / "contract.json").read_text(encoding="utf-8"))
    change(terms)
    terms.pop("sha256", None)
    (folder / "contract.json").write_text(json.dumps(terms))


def refusal(folder: Path, terms: dict[str, Any], change: Callable[[dict[str, Any]], Any]) -> str:
    """The sentence with which a folder is refused whose contract is ``terms``, changed."""
    changed = copy.deepcopy(terms)
    change(changed)
    changed.pop("sha256", None)
    (folder / "contract.json").write_text(json.dumps(changed))
    with pytest.raises(UavrlError) as caught:
        Policy(folder)
    assert "\n" not in str(caught.value), str(caught.value)
    return str(caught.value)


def put_network(folder: Path, content: bytes) -> None:
    """Replaces ``policy.onnx``, with its checksum."""
    (folder / "policy.onnx").write_bytes(content)
    edit_contract(folder, lambda terms: terms["network"].update(sha256=hashlib.sha256(content).hexdigest()))
