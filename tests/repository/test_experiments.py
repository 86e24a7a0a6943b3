"""The experiments fly what the thesis's figures and tables tell."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from itertools import product
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.helpers.configs import composed, with_hydra
from uavrl.config import TrainConfig, conf_dir, learner_name, validate

EXPERIMENTS = sorted(path.stem for path in (conf_dir() / "experiment").glob("[ft]*_4_*.yaml"))  # the thesis's
REWARD_PRESETS = sorted(path.stem for path in (conf_dir() / "reward_preset").glob("*.yaml"))
THESIS = json.loads((files("uavrl.reporting") / "thesis.json").read_text(encoding="utf-8"))
REWARDS = {("traditional", "none"): "TR", ("navigation", "abr"): "ABR", ("navigation", "abr_plus"): "ABR⁺"}


@cache
def combinations(experiment: str) -> list[tuple[Any, TrainConfig]]:
    """Every run of an experiment, as Hydra's sweeper makes them."""
    runs = []
    hydra = with_hydra("config", f"experiment={experiment}").hydra
    params = hydra.sweeper.params or {}
    assert str(hydra.mode) == "RunMode.MULTIRUN"
    for values in product(*(str(choices).split(",") for choices in params.values())):
        overrides = [f"{key}={value}" for key, value in zip(params, values, strict=True)]
        config = composed("config", f"experiment={experiment}", *overrides)
        runs.append((config, validate(config)))
    return runs


def cell(config: Any, settings: TrainConfig) -> tuple[str, str, str]:
    """Where a run stands in the thesis's tables: environment, learner and reward."""
    chosen = settings.choices
    reward = REWARDS[(chosen["reward"], chosen["backward_reward"])]
    return chosen["env"], learner_name({**chosen, "backward_reward": "none"}), reward


def in_thesis(table: str, *sources: str) -> set[tuple[str, str, str]]:
    rows = [row for row in THESIS[table] if any(source in row["source"] for source in sources)]
    return {(row["env"], row["learner"], row["reward"]) for row in rows}


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_an_experiments_runs_differ_in_name_and_are_the_thesis_length(experiment: str) -> None:
    runs = combinations(experiment)
    folders = [config.run_dir for config, _ in runs]
    assert len(set(folders)) == len(folders)
    assert all(folder.startswith(f"runs/{experiment}/") for folder in folders)
    assert {settings.trainer.episodes for _, settings in runs} == {THESIS["episodes"]}


@pytest.mark.parametrize(
    ("experiment", "table", "source", "beside"),
    [
        ("figure_4_3", "rates", "4.3", set()),
        ("figure_4_4", "rates", "4.4", set()),
        ("figure_4_5", "rates", "4.5", {("dynamic", "td3_fork", "TR"), ("dynamic", "td3_lg", "TR")}),
        ("table_4_2", "steps_to", "4.2", set()),
    ],
)
def test_an_experiment_flies_every_cell_of_its_figure(
    experiment: str, table: str, source: str, beside: set[tuple[str, str, str]]
) -> None:
    flown = {cell(*run) for run in combinations(experiment)}
    assert flown - beside == in_thesis(table, f"Figure {source}", f"Figures {source}", f"Table {source}", f", {source}")
    assert beside <= flown


def test_figure_4_2_is_a_plain_run_in_the_static_valley() -> None:
    ((config, settings),) = combinations("figure_4_2")
    assert cell(config, settings) == ("static", "td3", "TR")


@pytest.mark.parametrize("reward_preset", REWARD_PRESETS)
def test_a_reward_preset_changes_what_is_paid_alone(reward_preset: str) -> None:
    before, after = (
        OmegaConf.to_container(composed("config", *chosen), resolve=True)
        for chosen in ([], [f"reward_preset={reward_preset}"])
    )
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    changed = {key for key in before | after if before.get(key) != after.get(key)} - {"run_dir", "choices"}
    assert changed <= {"reward", "backward_reward"}
    assert bool(changed) == (reward_preset != "prize")  # the default pays the prize
    assert (after["choices"]["reward"] == "navigation_prize") == reward_preset.endswith("prize")
