"""An evaluation flies in valleys that its policy was not trained in, unless the training's own are asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from tests.helpers.commands import VALLEY, in_process
from tests.helpers.folders import ROOT
from uavrl.cli import evaluate as command
from uavrl.config import EvaluateConfig, compose, validate
from uavrl.envs import world as world_module
from uavrl.envs.place import Place
from uavrl.envs.rules import WorldRules
from uavrl.errors import UavrlError
from uavrl.evaluation.overrides import output_name
from uavrl.evaluation.policies import PACKAGED
from uavrl.evaluation.policy_setup import choose
from uavrl.evaluation.worlds import unseen_seeds, worlds_text
from uavrl.runs.config import load_config
from uavrl_onboard.values import to_plain

TRAINED = list(range(48))
HELD_OUT = list(range(100, 110))


def chosen(*overrides: str) -> Any:
    """The environment and the source of packaged best, or of what is named."""
    words = [*overrides] if any(word.startswith("policy=") for word in overrides) else ["policy=best", *overrides]
    config = compose(*words, name="evaluate")
    settings = validate(config, EvaluateConfig)
    folder = PACKAGED / "best" if settings.policy == "best" else None
    return choose(settings, config, words, folder, torch.device("cpu"))


def seeds(*overrides: str) -> list[int]:
    return list(chosen(*overrides).env.world.seeds)


def test_the_default_is_the_row_of_the_suite_that_is_called_held_out() -> None:
    suite = yaml.safe_load((ROOT / "conf/suite.yaml").read_text())["held_out"]
    row, default = chosen(*suite, "valleys=[100,101,102,103,104,105,106,107,108,109]"), chosen()
    assert list(default.env.world.seeds) == HELD_OUT
    worlds = [to_plain(each.env) for each in (row, default)]
    for world in worlds:
        del world["num_uavs"], world["world"]["plane_wingspan"]  # of vehicles at a time, and of no planes
        assert world.pop("max_speed", 2.0) == 2.0  # the default, where the policy's own file does not say it
    assert worlds[0] == worlds[1]
    trained = load_config(PACKAGED / "best/config.yaml").env
    assert list(trained.world.seeds) == TRAINED and list(trained.world.obstacles) == [45, 90], (
        "its training varies both"
    )


def test_the_training_s_own_worlds_come_back_by_a_key() -> None:
    own = chosen("valleys=training")
    assert list(own.env.world.seeds) == TRAINED and list(own.env.world.obstacles) == [45, 90]
    assert own.env.randomize.is_on and not chosen().env.randomize.is_on


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["valleys=[3,100]"], [3, 100]),
        (["env=dynamic"], HELD_OUT),
        (["env=dynamic", "valleys=training"], [0]),
        (["env.world.seeds=[5]"], [5]),
        (["policy=straight"], HELD_OUT),
        (["policy=straight", "valleys=training"], [0]),
    ],
)
def test_what_the_command_line_says_is_flown(overrides: list[str], expected: list[int]) -> None:
    assert seeds(*overrides) == expected


def test_what_is_typed_of_obstacles_and_vehicles_stays() -> None:
    env = chosen("randomize=real", "env.world.obstacles=[3,4]").env
    assert env.randomize.is_on and tuple(env.world.obstacles) == (3, 4)


def test_valleys_of_the_training_are_not_called_unseen() -> None:
    assert unseen_seeds(range(95, 105)) == tuple(range(105, 115))


@pytest.mark.parametrize("value", ["[]", "[-1]", "seen", "null"])
def test_other_words_are_refused(value: str) -> None:
    with pytest.raises(UavrlError, match=r"valleys must be (one of )?unseen, training or a list"):
        validate(compose("policy=straight", f"valleys={value}", name="evaluate"), EvaluateConfig)


def test_the_text_says_how_many_of_the_valleys_were_trained_in() -> None:
    told = {"env": "static", "training_valleys": TRAINED}
    assert worlds_text({**told, "valleys": TRAINED}) == "its 48 training valleys (seeds 0–47), env=static"
    assert worlds_text({**told, "valleys": [0]}) == "1 of its training valleys (seed 0), env=static"
    both = "3 valleys, 1 of them from its training (seeds 2, 100–101), env=static"
    assert worlds_text({**told, "valleys": [2, 100, 101]}) == both
    assert worlds_text({"env": "walker"}) == "env=walker"


def test_a_command_builds_the_valleys_of_its_tasks_alone_and_says_so_from_the_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Vehicles that are done before the last one go on in the valleys that there are."""
    built, build = [], world_module.build_place

    def recorded(config: WorldRules, number: int, origin: np.ndarray) -> Place:
        built.append(config.seeds[number])
        return build(config, number, origin)

    monkeypatch.setattr(world_module, "build_place", recorded)
    monkeypatch.setenv("UAVRL_CACHE", str(tmp_path / "cache"))
    output = tmp_path / "told.json"
    words = ["policy=straight", "episodes=3", "env.max_steps=60", *VALLEY, f"output={output}"]
    assert in_process(command.main, *words) == 0
    result = json.loads(output.read_text())
    flown = {flight["world_seed"] for flight in result["flights"]}
    assert set(built) == flown and len(built) == len(flown) < 4 and result["valleys"] == HELD_OUT
    steps = [flight["steps"] for flight in result["flights"]]
    assert min(steps) < max(steps), "one goes on while another flies"
    out, err = capfd.readouterr()
    assert "Worlds: 10 valleys (seeds 100–109), env=static\nSuccess rate: " in out
    lines = err.splitlines()
    order = [next(i for i, line in enumerate(lines) if line.startswith(word)) for word in TOLD]
    assert order == sorted(order) and order[0] == 0, lines


TOLD = ("Loading straight", "Flying 3 tasks in 10 valleys (seeds 100–109), env=static.", "building valleys 0/")


def test_outcomes_do_not_depend_on_which_valleys_are_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for name, tasks in (("few", 3), ("more", 12)):
        output = tmp_path / f"{name}.json"
        words = ["policy=straight", f"episodes={tasks}", "num_uavs=3", "env.max_steps=40", "progress=false", *VALLEY]
        assert in_process(command.main, *words, f"output={output}") == 0
        results.append(json.loads(output.read_text())["flights"][:3])
    few, more = results
    assert [(f["task"], f["outcome"], f["steps"], f["world_seed"]) for f in few] == [
        (f["task"], f["outcome"], f["steps"], f["world_seed"]) for f in more
    ]


def test_worlds_of_another_kind_are_not_those_of_the_training() -> None:
    overrides = ["policy=best", "env=forest"]
    config = compose(*overrides, name="evaluate")
    setup = choose(validate(config, EvaluateConfig), config, overrides, PACKAGED / "best", torch.device("cpu"))
    assert "training_valleys" not in setup.source
    overrides.append("valleys=training")
    config = compose(*overrides, name="evaluate")
    with pytest.raises(UavrlError, match="env=forest is of another kind: leave valleys out"):
        choose(validate(config, EvaluateConfig), config, overrides, PACKAGED / "best", torch.device("cpu"))


def test_a_long_name_of_a_result_is_cut_and_still_its_own() -> None:
    one, other = (output_name("evaluation", [f"env.world.file={'a' * 300}{end}"]) for end in "xy")
    assert one != other and len(one) < 140
    assert output_name("evaluation", ["env=static"]) == "evaluation_env=static"
