"""What the yaml files compose to, and what a preset or a choice changes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hydra import compose as hydra_compose
from hydra import initialize_config_dir, version
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import OmegaConf

from tests.helpers.configs import composed
from uavrl.config import EvaluateConfig, TrainConfig, compose, conf_dir, learner_name, resolve, validate
from uavrl.config.parts import PARTS
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import load_policy
from uavrl.policies.baselines import COSTS, VFHWeights
from uavrl_onboard.values import to_plain

FILES = sorted((path.parent.name, path.stem) for path in conf_dir().glob("*/*.yaml"))
CHOICES = [file for file in FILES if file[0] not in ("pretrain", "reward_preset", "experiment", "learner", "preset")]
YAML_FILES = sorted(conf_dir().rglob("*.yaml"))


def settings(*overrides: str) -> TrainConfig:
    return validate(composed("config", *overrides))


def part(group: str, *overrides: str) -> dict[str, Any]:
    return to_plain(getattr(settings(*overrides), group))  # type: ignore[no-any-return]


# ---------------------------------------------------------------------- in a program that uses Hydra itself


@pytest.fixture
def their_hydra(tmp_path: Path) -> Iterator[Callable[[], tuple[object, ...]]]:
    """Hydra as ``@hydra.main`` sets it up; gives all that it is made of."""
    (tmp_path / "theirs.yaml").write_text("env: their own\n")
    with initialize_config_dir(str(tmp_path), version_base="1.2"):
        HydraConfig.instance().set_config(hydra_compose("theirs", return_hydra_config=True))
        OmegaConf.register_new_resolver("run_name", lambda: "theirs", replace=True)
        yield lambda: (
            GlobalHydra.instance(),
            GlobalHydra.instance().hydra,
            HydraConfig.instance().cfg,
            version.getbase(),
            OmegaConf.create({"a": "${run_name:}"}).a,
            hydra_compose("theirs").env,
        )
    HydraConfig.instance().cfg = None
    OmegaConf.clear_resolver("run_name")


def test_it_composes_in_a_program_of_hydra_s_and_leaves_it_as_it_was(
    their_hydra: Callable[[], tuple[object, ...]],
) -> None:
    before = their_hydra()
    config = compose("algo=sac", "env=dynamic")
    assert "dynamic_sac_" in config.run_dir
    assert config.choices.algo == "sac"
    with pytest.raises(HydraException):
        compose("algo=none_of_these")
    with pytest.raises(UavrlError, match="make_env cannot take env=none_of_these"):
        load_policy("best").make_env("env=none_of_these")
    for was, now in zip(before, their_hydra(), strict=True):
        assert now is was or now == was


def test_it_leaves_no_hydra_behind_where_there_was_none() -> None:
    compose("algo=sac")
    assert not GlobalHydra.instance().is_initialized()
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        assert hydra_compose("config").algo


# ---------------------------------------------------------------------- composing


@pytest.mark.parametrize(("group", "name"), CHOICES)
def test_every_choice_composes_for_training_and_says_so(group: str, name: str) -> None:
    file = ["env.world.file=site.ply"] if name in ("mesh", "cloud") else []
    config = settings(f"{group}={name}", *file)
    assert config.choices[group] == name
    assert group not in PARTS or (getattr(config, group)._target_ is None) == (name == "none")


@pytest.mark.parametrize("name", ["static", "dynamic"])
def test_every_environment_composes_for_evaluation(name: str) -> None:
    config = validate(composed("evaluate", f"env={name}"), EvaluateConfig)
    assert config.choices["env"] == name


@pytest.mark.parametrize("algo", ["td3", "ddpg", "sac"])
@pytest.mark.parametrize("penalties", [[], ["fork=on", "lifeguard=mlp"]], ids=["bare", "penalized"])
def test_what_a_run_writes_is_read_as_it_was(algo: str, penalties: list[str], tmp_path: Path) -> None:
    config = resolve(composed("config", f"algo={algo}", "run_dir=here", "env=dynamic", *penalties))
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    again = OmegaConf.load(tmp_path / "config.yaml")
    assert resolve(again) == config
    assert validate(again) == validate(config)


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_key_has_a_comment(path: Path) -> None:
    lines = path.read_text().splitlines()
    hydra = next((i for i, line in enumerate(lines) if line.startswith("hydra:")), len(lines))
    bare = [
        line
        for line in lines[:hydra]
        if re.match(r"\s*\w+:", line)
        and "#" not in line
        and not re.match(r"\s*(defaults|_target_|name|world|trainer|algo|env|buffer):", line)
    ]
    assert not bare


# ---------------------------------------------------------------------- what is told of another choice


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ([], "td3"),
        (["learner=td3_lg"], "td3_lg"),
        (["fork=on", "lifeguard=mlp"], "td3_fork_lg_mlp"),
        (["algo=ddpg", "fork=on", "backward_reward=abr"], "ddpg_fork_abr"),
    ],
)
def test_run_folders_are_named_for_what_learns(overrides: list[str], name: str) -> None:
    config = composed("config", *overrides)
    assert learner_name(config.choices) == name
    assert f"_static_{name}_navigation_prize_seed0" in config.run_dir


def test_the_thesis_pays_less_for_a_collision_with_lifeguard() -> None:
    def cost(*overrides: str) -> float:
        return settings(*overrides).reward.collided_reward

    assert (cost(), cost("lifeguard=linear"), cost("learner=td3_fork", "reward_preset=abr")) == (-50.0, -50.0, -50.0)
    assert (cost("learner=td3_lg"), cost("learner=td3_lg", "reward_preset=abr_plus")) == (-10.0, -10.0)
    assert (cost("learner=td3_lg", "reward_preset=tr"), cost("learner=td3_lg", "reward.collided_reward=-50")) == (
        -50.0,
        -50.0,
    )


def test_forks_weight_fades_at_a_return_that_the_reward_can_reach() -> None:
    def fades_at(*overrides: str) -> float:
        return settings("fork=on", *overrides).fork.max_reward

    assert (fades_at(), fades_at("reward=navigation"), fades_at("reward_preset=abr_plus")) == (460.0, 460.0, 460.0)
    assert (fades_at("reward=traditional"), fades_at("reward_preset=tr")) == (66.0, 66.0)
    assert fades_at("reward_preset=tr", "fork.max_reward=80") == 80.0


def test_the_prize_is_what_loitering_for_ever_would_earn() -> None:
    prize, thesis = part("reward", "reward=navigation_prize"), part("reward", "reward=navigation")
    assert thesis.pop("arrived_reward") == 0.0
    gamma = part("algo")["gamma"]
    assert prize.pop("arrived_reward") == pytest.approx(sum(thesis["weights"][1:]) / (1 - gamma))
    assert prize == thesis


def test_the_dynamic_environment_differs_in_its_planes_only() -> None:
    dynamic, static = part("env", "env=dynamic"), part("env")
    assert dynamic["world"].pop("planes") == 10 and static["world"].pop("planes") == 0
    assert dynamic == static


def test_the_lidars_range_and_the_observations_altitude_follow() -> None:
    assert settings("perception.radius=5.5").perception.lidar.max_range == 5.5
    assert settings("env.world.flight_level=3").perception.flight_level == 3.0


def test_the_best_preset_leaves_the_default_as_it_is_and_can_be_changed_in_turn() -> None:
    plain_run, best = settings(), settings("preset=dagger", "algo.n_steps=5", "reward_preset=abr_prize")
    assert (plain_run.algo.n_steps, plain_run.algo.layer_norm, plain_run.algo.exploration_spread) == (1, False, 1.0)
    assert (plain_run.buffer.mirror, plain_run.choices["demonstrator"], plain_run.choices["actor_penalty"]) == (
        False,
        "none",
        "none",
    )
    assert (best.algo.n_steps, best.algo.critic.layer_norm, best.buffer.mirror) == (5, True, True)
    assert best.algo.actor.hidden == [256, 256]
    assert [best.choices[group] for group in ("backward_reward", "reward")] == ["abr", "navigation_prize"]
    assert settings("preset=dagger", "env=dynamic").env.world.planes == 10


# ---------------------------------------------------------------------- presets


@pytest.mark.parametrize(
    ("overrides", "angles", "term", "reward"),
    [
        (["preset=thesis"], "raw", None, "traditional"),
        (["preset=thesis", "reward_preset=abr_printed"], "raw", "literal", "navigation_printed"),
        (["preset=thesis", "reward_preset=abr_plus_printed"], "raw", "literal", "navigation_printed"),
        (["preset=thesis", "reward_preset=abr"], "raw", "absolute", "navigation"),
        (
            ["preset=thesis", "reward_preset=abr_printed", "perception.angles=turns"],
            "turns",
            "literal",
            "navigation_printed",
        ),
        (["reward_preset=abr"], "folded", "absolute", "navigation"),
    ],
)
def test_the_thesis_and_one_factor_at_a_time(overrides: list[str], angles: str, term: str | None, reward: str) -> None:
    config = compose(*overrides)
    found = (config.perception.angles, config.reward.get("altitude_term"), config.choices.reward)
    assert found == (angles, term, reward)


def test_a_demonstrator_assumes_the_hull_of_the_vehicle_that_it_flies() -> None:
    wide = settings("demonstrator=vfh", "env.airframe.collision_radius=0.5")
    assert wide.demonstrator.airframe == wide.env.airframe and wide.env.airframe.collision_radius == 0.5


def test_the_best_preset_stays_near_a_guide_in_many_valleys() -> None:
    config = compose("preset=td3_bc")
    assert len(config.env.world.seeds) == 48 and not set(config.env.world.seeds) & set(range(100, 110))
    assert (config.demonstrator.reduction, compose("demonstrator=vfh").demonstrator.reduction) == (
        "range_image",
        "truncated_icosahedron",
    )
    assert (config.choices.reward, config.choices.backward_reward) == ("traditional", "none")
    assert config.actor_penalty._target_.endswith(".Imitation")
    assert (config.perception.statistic, config.perception.last_action) == ("proximity", True)
    perceptions = [
        to_plain(dict(compose(f"perception={name}").perception)) for name in ("truncated_icosahedron", "range_image")
    ]
    assert perceptions[1] == perceptions[0] | {"reduction": "range_image", "statistic": "proximity"}


def test_dagger_lasts_for_all_of_its_preset_and_clones_a_faster_controller_in_some_of_the_valleys_of_td3_bc() -> None:
    short, long = compose("preset=dagger"), compose("preset=td3_bc")
    assert short.cloning._target_.endswith(".Cloning") and (short.cloning.steps, short.trainer.steps) == (None, 30_000)
    assert compose("preset=dagger", "cloning=none").cloning._target_ is None, "TD3 with its parts"
    assert long.cloning._target_ is None and long.trainer.steps == 100_000
    assert (short.trainer.lidar_stride, long.trainer.lidar_stride) == (4, 1)
    assert set(short.env.world.seeds) < set(long.env.world.seeds)
    short.env.world.seeds = long.env.world.seeds
    ours, usual = VFHWeights(**short.demonstrator.costs), COSTS["range_image", "proximity"]
    assert ours == replace(usual, caution=ours.caution, headway=ours.headway) and ours.headway > 0
    short.demonstrator.costs = None
    for part in ("env", "perception", "reward", "demonstrator", "buffer", "actor_penalty", "smoothness", "collector"):
        assert short[part] == long[part], part


def test_only_the_runs_name_and_the_cells_reach_are_worked_out_by_code_of_ours() -> None:
    """The reach follows env.max_speed by a formula, which yaml cannot write, and other keys follow the reach."""
    ours = r"\$\{(?!now:)(?!\w+:\w+\})\w+:"  # a call: ${uavrl_run_name:}, ${where:a,b}
    called = {call for path in YAML_FILES for call in re.findall(ours, path.read_text())}
    assert called == {"${uavrl_run_name:", "${uavrl_sight:"}


# ---------------------------------------------------------------------- randomized vehicles


@pytest.mark.parametrize("name", ["config", "evaluate", "replay"])
def test_one_word_randomizes_everything_and_one_quantity_can_be_switched_off(name: str) -> None:
    config = compose(
        "randomize=real", "env.randomize.mass=null", *([] if name == "config" else ["policy=best"]), name=name
    )
    drawn = OmegaConf.to_container(config.env.randomize)
    assert [key for key, value in drawn.items() if value is None] == ["mass"]
    assert drawn["thrust"] == [0.85, 1.15] and drawn["blind_sector"] == [0.0, 1.0472]


@pytest.mark.parametrize("preset", [path.stem for path in (conf_dir() / "preset").glob("*.yaml")])
def test_a_preset_randomizes_nothing_unless_it_says_so(preset: str) -> None:
    randomize = settings(f"preset={preset}").env.randomize
    assert randomize.is_on == ("randomize" in (conf_dir() / f"preset/{preset}.yaml").read_text())
    assert not settings("preset=thesis").env.randomize.is_on and not settings().env.randomize.is_on


@pytest.mark.parametrize(
    ("override", "told"),
    [
        (
            "env.randomize.mass=[1.2,0.8]",
            r"env\.randomize\.mass must be two numbers in \[0\.1, 10\], the lower one first",
        ),
        ("env.randomize.thrust=[-1,1]", r"env\.randomize\.thrust must be two numbers"),
        ("env.randomize.drag=0.5", r"env\.randomize\.drag must be a list"),
        ("env.randomize.wind=[1]", r"env\.randomize\.wind must be a list of 2"),
        ("+env.randomize.wnd=[1,2]", r"did you mean env\.randomize\.wind\?"),
    ],
)
def test_what_is_no_range_is_refused_by_its_key(override: str, told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        settings(override)
