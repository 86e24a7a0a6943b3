"""A mistake on the command line is answered by what was meant, also with yaml files of one's own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.own_parts import CONFIG_DIR, TRUSTED
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import train as train_command


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A folder with a reward of one's own, which leaves out what its class takes, and with a file that nobody chose."""
    folder = tmp_path / "my yaml's"
    (folder / "reward").mkdir(parents=True)
    (folder / "reward" / "bold.yaml").write_text(
        "_target_: uavrl.transforms.rewards.TraditionalReward\ncollided_reward: -50.0\nboldness: 1.0\n"
    )
    (folder / "reward" / "broken.yaml").write_text("weights: [1.0\n")
    monkeypatch.chdir(tmp_path)
    return ["--config-dir", str(folder)]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["reward=bold", "reward.arrived_reward=100"],
            "choose that one, or write +reward.arrived_reward=VALUE where the class of this one takes it.",
        ),
        (
            ["reward=traditional", "reward.boldness=2"],
            "reward.boldness belongs to another choice of reward than the one made: choose that one",
        ),
        (["reward=traditional", "reward.boldnes=2"], "There is no key 'reward.boldnes': did you mean reward.boldness?"),
        (["reward=bald"], "got 'bald': did you mean bold?"),
        (["reward=xyz"], "my yaml's has no reward/xyz.yaml."),
    ],
)
def test_yaml_files_of_ones_own_are_known(
    arguments: list[str], told: str, own: list[str], refused: Callable[..., str]
) -> None:
    assert told in refused(train_command.main, *own, *arguments)


@pytest.mark.parametrize("choice", ["reward=bold", "env=corridor", "preset=mine", "learner=mine", "actor_penalty=calm"])
def test_without_their_folder_the_option_is_named(choice: str, refused: Callable[..., str]) -> None:
    group, _, name = choice.partition("=")
    sentence = refused(train_command.main, choice)
    assert f"{group} must be one of " in sentence and f"got '{name}'" in sentence
    assert sentence.endswith("A choice of your own needs --config-dir FOLDER.")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["env.blind=true"],
            "If the class of env takes it, write +env.blind=VALUE.",
        ),
        (
            ["algo=sac", "algo.actor.log_scale=[1.0,2.0]"],
            "If the class of algo takes it, write +algo.actor.log_scale=VALUE.",
        ),
        (["fork=on", "fork.gamma=0.5"], "There is no key 'fork.gamma'"),  # the run's own: no plus sign helps
        (
            ["perception.lidar.channels=32"],
            "There is no key 'perception.lidar.channels': perception.lidar has dropout, ",
        ),
        (["perception.lidar.max_rang=3"], "did you mean perception.lidar.max_range?"),
        (
            ["algo.gamma=0.9,0.8"],
            "algo.gamma got several values, 0.9,0.8: give one, or add -m to train with each of them",
        ),
        (["preset=dager"], "got 'dager': did you mean dagger?"),
        (["preset=fast"], "preset must be one of dagger, td3_bc, thesis, got 'fast'."),
        (["randomize.mass=[1,2]"], "There is no key 'randomize.mass': did you mean env.randomize.mass?"),
        (["--seed", "1"], "uavrl-train has no option --seed: write seed=VALUE."),
        (["--seeds=1"], "uavrl-train has no option --seeds=1: did you mean seed?"),
        (["--colour", "red"], "uavrl-train has no option --colour: values are written KEY=VALUE, and --help explains"),
        (["-q"], "uavrl-train has no option -q: values are written KEY=VALUE"),
        (["--cfg", "red"], "uavrl-train: argument --cfg/-c: invalid choice: 'red'"),
        (["--config-dir", "none"], "none' not found: give --config-dir a folder of yaml files that is there."),
        (
            ["seed=1", *CONFIG_DIR, "env=corridor"],
            "uavrl-train takes options before all that is KEY=VALUE: env=corridor",
        ),
        (["runs/a"], "The override 'runs/a' cannot be read: write KEY=VALUE, as in uavrl-train preset=dagger."),
    ],
)
def test_so_are_ours(arguments: list[str], told: str, refused: Callable[..., str]) -> None:
    assert told in refused(train_command.main, *arguments)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["policy=bst"],
            "policy must be one of straight, vfh, vfh_star, mppi, potential_field, rrt_connect, rrt_map, "
            "best, best_dynamic, got 'bst': did you mean best?",
        ),
        (
            ["policy=best,vfh"],
            "policy got several values, best,vfh: give one, and start the command once for each of them",
        ),
        (["policy=???"], "policy must be given, and is not: add policy=VALUE."),
        (["policy='${oc.env:NOWHERE}'"], "The configuration does not hold together at policy"),
        (["policy=best", "suite=denze"], "got 'denze': did you mean dense?"),
        (["policy=best", "episode=3"], "did you mean episodes?"),
        (["policy=best", "num_uavs=1000000"], "num_uavs must be in [1, 512], got 1000000"),
        (["policy=best", "algo.gamma=0.9"], "There is no key 'algo.gamma': --help=all lists"),
        (["policy=best", "env=corridor"], "A choice of your own needs --config-dir FOLDER."),
        (
            [*CONFIG_DIR, TRUSTED, "policy=best", "env=corridor", "reward=hurry"],
            "The policy and env=corridor do not go",
        ),
    ],
)
def test_what_is_evaluated_is_guessed_too(arguments: list[str], told: str, refused: Callable[..., str]) -> None:
    assert told in refused(evaluate_command.main, *arguments)
