"""What a run of an older uavrl has recorded is read as it was meant, or refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from tests.helpers.configs import changed
from tests.helpers.folders import ROOT, run_folder
from uavrl.config import resolve, validate, validate_run
from uavrl.config.build import TARGET, find_class
from uavrl.config.recorded import GONE, MOVED, renewed
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import PACKAGED, packaged_policies
from uavrl.reporting.runs import read_run
from uavrl.runs.config import FREE_KEYS, MACHINE_KEYS, fingerprint, fingerprints, load_config
from uavrl.training.run import resume_config


@pytest.mark.parametrize(("before", "now"), MOVED.items())
def test_a_class_that_has_moved_is_found_where_it_lies(before: str, now: str) -> None:
    assert find_class(now, object).__name__ == before.rpartition(".")[2]
    config = changed(["guide=vfh"])
    expected = validate(config)
    for part in config.values():
        if isinstance(part, DictConfig) and part.get(TARGET) == now:
            part[TARGET] = before
    assert validate_run(config) == expected


def test_a_run_that_has_recorded_an_unused_value_still_loads(caplog: pytest.LogCaptureFixture) -> None:
    config = changed(["fork=on"])
    before = validate(config)
    OmegaConf.set_struct(config, False)
    config.fork.gamma, config.fork.system_network.actions, config.buffer.frames = 0.5, 9, 1
    assert validate_run(config) == before
    assert config.fork.gamma == 0.5, "what it was trained with is recognised by all that was recorded"
    assert "fork.gamma in the run's configuration was never used: it is left out." in caplog.text


def test_the_policy_of_a_run_with_products_of_before_still_loads() -> None:
    config = changed(["fork=on"])
    config.trainer.matmul = "bf16"
    assert validate_run(config).trainer.matmul == "mkl"


@pytest.mark.parametrize("name", packaged_policies())
def test_packaged_policies_are_read_without_a_word(name: str, caplog: pytest.LogCaptureFixture) -> None:
    config = load_config(PACKAGED / name / "config.yaml")
    before = config.copy()
    assert validate_run(config).algo._target_ == config.algo._target_
    assert config == before and not caplog.records


TODAY = ["backward_reward=abr", "reward=traditional", "fork=on", "run_dir=runs/before"]  # else named by the second


def recorded_before() -> DictConfig:
    """With every key that there is no longer."""
    config = changed(TODAY)
    OmegaConf.set_struct(config, False)
    for key, value in GONE.items():
        OmegaConf.update(config, key, 1000 if value is None else value, force_add=True)
    return config


def test_a_run_with_keys_of_before_still_loads_where_they_say_what_is_done_today() -> None:
    assert validate_run(recorded_before()) == validate(changed(TODAY))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("env.goal_angle", "course"),
        ("reward.time_cost", 0.25),
        ("backward_reward.scale", "centred"),
        ("fork.variant", "bipedal"),
    ],
)
def test_and_is_refused_where_they_say_something_else(key: str, value: object) -> None:
    config = recorded_before()
    OmegaConf.update(config, key, value)
    with pytest.raises(UavrlError, match=f"^The run was flown with {re.escape(key)}={value}, which there no longer is"):
        validate_run(config)


def test_a_key_of_somebody_elses_part_stays() -> None:
    config = OmegaConf.create({"env": {TARGET: "own_parts.env.Corridor", "goal_angle": "course"}})
    assert renewed(config) == config


def test_keys_that_had_other_names_are_read_and_their_checkpoints_known(tmp_path: Path) -> None:
    now = resolve(changed(["guide=vfh", "actor_penalty=imitation", f"run_dir={tmp_path}"]))
    before = now.copy()
    before.trainer.products, before.algo.random_steps = before.trainer.pop("matmul"), before.algo.pop("learning_starts")
    before.enhancer = before.pop("actor_penalty")
    before.choices.enhancer = before.choices.pop("actor_penalty")
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(before))
    found = load_config(tmp_path / "config.yaml")
    assert found == now
    assert fingerprint(before, (*FREE_KEYS, *MACHINE_KEYS, "trainer.products")) in fingerprints(found)


@pytest.mark.parametrize(
    "path", sorted((ROOT / "docs/data/fast").rglob("config.yaml")), ids=lambda path: path.parent.name
)
def test_the_runs_that_the_docs_show_are_read(path: Path) -> None:
    validate_run(load_config(path))


def test_a_run_of_a_preset_that_there_is_no_longer_is_read_reported_and_resumed(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "run", "aac", {"preset": "fast"})
    assert read_run(run, "run").choices["preset"] == "fast"
    more = resume_config(run, changed(["trainer.episodes=9"]), ["trainer.episodes"])
    assert (more.trainer.episodes, more.choices.preset) == (9, "fast")
    assert validate_run(more).choices["preset"] == "fast"
