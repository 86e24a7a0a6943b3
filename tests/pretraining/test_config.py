"""conf/pretrain.yaml, conf/pretrain/*.yaml and their dataclasses say the same."""

from __future__ import annotations

import inspect
from dataclasses import asdict, fields
from typing import Any

import pytest
import yaml

from tests.helpers.configs import composed
from uavrl.config import conf_dir, validate
from uavrl.errors import UavrlError
from uavrl.losses import PSAELoss
from uavrl.models import PSAE, TrajectoryClassifier
from uavrl.pretraining.settings import PretrainConfig, PretrainRecipe


def settings(*overrides: str) -> Any:
    return validate(composed("pretrain", *overrides), PretrainConfig)


@pytest.mark.parametrize("name", sorted(path.stem for path in (conf_dir() / "pretrain").glob("*.yaml")))
def test_every_recipe_composes_and_names_every_key(name: str) -> None:
    config = settings(f"pretrain={name}")
    assert isinstance(config, PretrainConfig) and isinstance(config.pretrain, PretrainRecipe)
    assert config.pretrain.name == name
    written = yaml.safe_load((conf_dir() / "pretrain" / f"{name}.yaml").read_text())
    assert set(written) - {"defaults"} == {field.name for field in fields(PretrainRecipe)}


def test_full_is_the_dataclass() -> None:
    written = {k: tuple(v) if isinstance(v, list) else v for k, v in asdict(settings().pretrain).items()}
    assert written == asdict(PretrainRecipe())


def test_full_has_the_numbers_of_the_thesis() -> None:
    recipe = settings().pretrain
    assert (recipe.states, recipe.features, recipe.tradeoff, recipe.compare_k) == (200_000, 20, 0.7, 4000)
    assert (min(recipe.clusters), max(recipe.clusters), 4000 in recipe.clusters) == (100, 6000, True)


def test_top_level_yaml_holds_every_field_and_default() -> None:
    written = yaml.safe_load((conf_dir() / "pretrain.yaml").read_text())
    values = {key: value for key, value in written.items() if key not in ("defaults", "hydra")}
    defaults = {field.name: field.default for field in fields(PretrainConfig) if field.name != "pretrain"}
    assert values == defaults


def test_constructors_default_to_the_configuration() -> None:
    def default(function: Any, name: str) -> Any:
        return inspect.signature(function).parameters[name].default

    recipe = PretrainRecipe()
    for function in (PSAE.__init__, TrajectoryClassifier.__init__):
        assert (default(function, "features"), default(function, "hidden")) == (recipe.features, recipe.hidden)
    assert default(PSAELoss.__init__, "tradeoff") == recipe.tradeoff
    assert default(TrajectoryClassifier.__init__, "classifier_hidden") == recipe.classifier_hidden


OUT_OF_RANGE = """
    seed=-1 threads=0 matmul=blas pretrain.states=0 pretrain.features=0 pretrain.hidden=0 pretrain.tradeoff=1.5
    pretrain.psae_epochs=0 pretrain.psae_batch_size=0 pretrain.psae_lr=0 pretrain.clusters=[5,4,3,2,6]
    pretrain.clusters=[1,2,3,4,5] pretrain.clusters=[2,3] pretrain.k=1 pretrain.kmeans_batch_size=0
    pretrain.kmeans_iterations=0 pretrain.classifier_hidden=[] pretrain.classifier_epochs=0
    pretrain.classifier_batch_size=0 pretrain.classifier_lr=-1 pretrain.held_out=0 pretrain.held_out=1
    pretrain.compare_k=0 pretrain.psae_lr=nan
"""


@pytest.mark.parametrize("override", OUT_OF_RANGE.split())
def test_values_out_of_range_are_refused_by_name(override: str) -> None:
    with pytest.raises(UavrlError, match=rf"\b{override.partition('=')[0]} must be"):
        settings(override)


def test_a_given_k_needs_no_curve() -> None:
    recipe = settings("pretrain.k=40", "pretrain.clusters=[]", "pretrain.compare_k=null").pretrain
    assert recipe.largest_k == 40
