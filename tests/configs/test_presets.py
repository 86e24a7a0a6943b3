"""What a preset chooses, and what it leaves alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, cast

import pytest
from omegaconf import OmegaConf

from uavrl.buffers import ABRPlus
from uavrl.configs import compose
from uavrl.errors import UavrlError
from uavrl.models.psae import packaged_artifact


@pytest.mark.parametrize(
    ("overrides", "angles", "term", "reward"),
    [
        (["preset=thesis"], "raw", None, "traditional"),
        (["preset=thesis", "scheme=abr"], "raw", "literal", "navigation"),
        (["preset=thesis", "scheme=abr", "reward.altitude_term=absolute"], "raw", "absolute", "navigation"),
        (["preset=thesis", "scheme=abr", "perception.angles=folded"], "folded", "literal", "navigation"),
        (["preset=thesis", "scheme=abr", "perception.angles=turns"], "turns", "literal", "navigation"),
        (["scheme=abr"], "folded", "absolute", "navigation"),
    ],
)
def test_the_thesis_and_one_factor_at_a_time(overrides: list[str], angles: str, term: str | None, reward: str) -> None:
    config = compose(*overrides)
    found = (config.perception.angles, config.reward.get("altitude_term"), config.choices.reward)
    assert found == (angles, term, reward)


def test_the_best_preset_is_the_fast_one_with_a_guide_in_many_valleys() -> None:
    config, fast = compose("preset=best"), compose("preset=fast")
    assert (config.algo.random_steps, fast.algo.random_steps) == (15_000, 2000)
    assert {**config.algo, "random_steps": 2000} == dict(fast.algo)
    assert (config.guide.reduction, compose("guide=vfh").guide.reduction) == ("range_image", "truncated_icosahedron")
    assert (config.choices.reward, config.choices.backward_reward) == ("traditional", "none")
    assert config.enhancer.weight == 1.0
    assert (config.perception.statistic, config.perception.last_action) == ("proximity", True)
    assert compose("perception.reduction=range_image").perception.statistic == "proximity"
    assert compose().perception.statistic == "face"


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
