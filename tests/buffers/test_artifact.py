"""ABR⁺ takes an artifact of the states that it reads, and of no others."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, cast

import pytest
from omegaconf import OmegaConf

from uavrl.buffers import ABRPlus
from uavrl.config import compose
from uavrl.errors import UavrlError
from uavrl.models.psae import packaged_artifact


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ("perception.angles=raw", "of perception.angles=folded, and this is raw: make one by uavrl-pretrain"),
        ("perception.angles=turns", "of perception.angles=folded, and this is turns"),
        ("perception.statistic=range", "of perception.statistic=face, and this is range"),
        ("perception.blind=true", "of perception.blind=False, and this is True"),
        ("perception.frames=4", "of perception.frames=3, and this is 4"),
    ],
)
def test_abr_plus_asks_for_an_artifact_of_the_states_that_it_reads(other: str, told: str) -> None:
    perception = OmegaConf.to_container(compose("env.world.flight_level=3").perception, resolve=True)
    ABRPlus(perception=cast(dict[str, Any], perception))
    ABRPlus(perception={"statistic": None, "a key of one's own": 1})
    perception = OmegaConf.to_container(compose(other).perception, resolve=True)
    with pytest.raises(UavrlError, match=told):
        ABRPlus(perception=cast(dict[str, Any], perception))


def test_of_an_artifact_that_does_not_tell_its_perception_the_width_alone_is_compared(tmp_path: Path) -> None:
    artifact = Path(shutil.copytree(packaged_artifact(), tmp_path / "artifact"))
    about = json.loads((artifact / "artifact.json").read_text())
    del about["perception"]
    (artifact / "artifact.json").write_text(json.dumps(about))
    kept = tmp_path / "kept"
    with pytest.raises(UavrlError, match="classifies states of 105 numbers, these have 70"):
        ABRPlus(artifact=str(artifact), observations=70, stacked=2, perception={"angles": "raw"}, kept=kept)
    assert not kept.exists(), "what is refused is not kept"
    ABRPlus(artifact=str(artifact), perception={"angles": "raw"}, kept=kept)
    assert sorted(path.name for path in kept.iterdir()) == ["artifact.json", "artifact.safetensors"]
