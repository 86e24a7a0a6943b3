"""What a preset chooses, and what it leaves alone."""

from __future__ import annotations

import pytest

from uavrl.buffers import ABRPlus
from uavrl.configs import compose
from uavrl.errors import UavrlError


@pytest.mark.parametrize(
    ("overrides", "angles", "term", "reward"),
    [
        (["preset=thesis"], "raw", None, "traditional"),
        (["preset=thesis", "scheme=abr"], "raw", "literal", "navigation"),
        (["preset=thesis", "scheme=abr", "reward.altitude_term=absolute"], "raw", "absolute", "navigation"),
        (["preset=thesis", "scheme=abr", "perception.angles=folded"], "folded", "literal", "navigation"),
        (["scheme=abr"], "folded", "absolute", "navigation"),
    ],
)
def test_the_thesis_and_one_factor_at_a_time(overrides: list[str], angles: str, term: str | None, reward: str) -> None:
    config = compose(*overrides)
    found = (config.perception.angles, config.reward.get("altitude_term"), config.choices.reward)
    assert found == (angles, term, reward)


@pytest.mark.parametrize(
    "other", ["perception.angles=raw", "perception.statistic=range", "perception.statistic=proximity"]
)
def test_abr_plus_asks_for_an_artifact_of_the_states_that_it_reads(other: str) -> None:
    assert compose("scheme=abr_plus").backward_reward.artifact == "packaged"
    artifact = compose("scheme=abr_plus", other).backward_reward.artifact
    with pytest.raises(UavrlError, match=f"for {other}: make one by uavrl-pretrain"):
        ABRPlus(artifact=artifact)
