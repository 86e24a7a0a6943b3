"""A mistake on the command line is answered in one sentence by what was meant, and leaves nothing behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.commands import TINY
from tests.helpers.own_parts import CONFIG_DIR, TRUSTED
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import train as train_command

MISTAKES = {
    "algo.gama=0.9": "There is no key 'algo.gama'",
    "+algo.gama=0.9": "There is no key 'algo.gama'",
    "algo.actor._target_=uavrl.models.actor_critic.Critic": "algo.actor must be a network that takes an observation",
    "device=cuda:99": "CUDA devices: use device=cpu",
    "device=meta": "device must be auto, cpu, cuda or cuda:<index>, got 'meta'",
    "env.world.min_clearance=9": "min_clearance",
    "episodes=60": "did you mean trainer.episodes?",
    "reward_preset=t": "reward_preset must be one of abr, abr_plus",
    "learner=td3_lg fork=on": "learner=td3_lg selects fork=none, but the command line selects fork=on",
    "reward_preset=tr reward=navigation": "selects reward=traditional, but the command line selects reward=navigation",
    "backward_reward=none reward_preset=abr": "selects backward_reward=abr, but the command line selects backward_rew",
    "algo=null": "Config group override must be a string",
    "algo.gamma=[1": "The override 'algo.gamma=[1' cannot be read",
    "run_dir=": "run_dir must be a folder to make, got ''",
    "resume=": "resume must be the folder of a run, got ''",
    "env.airframe.inertia=[1,1]": "uavrl: env.airframe.inertia must be a list of 3, got [1, 1]",
    "env.aerodynamics.wind=[1]": "uavrl: env.aerodynamics.wind must be a list of 3, got [1]",
    "perception.lidar.dropout=1": "uavrl: perception.lidar.dropout must be a probability in [0, 1), got 1.0",
    "perception.radius=1e30": "perception.radius must be in (0, 100], got 1e+30",
    "env.world.size=[1e9,1e9]": "uavrl: env.world.size and ceiling must make at most 200,000 m³ of a valley",
    "env.world.obstacles=1000000000": "uavrl: env.world.obstacles must be at most 2,000 in a valley",
    "env.world.obstacle_scale=1e6": "lower obstacles or obstacle_scale",
    "env.airframe.collision_radius=100": "uavrl: env.airframe.collision_radius and half of airframe.collision_height",
    "env.airframe.mass=-1": "uavrl: env.airframe: Mass, inertia, arm",
    "trainer.updates_per_step=1e9": "trainer.updates_per_step must be in (0, 100], got 1000000000.0",
    "trainer.threads=1000000": "trainer.threads must be in [1, 256], got 1000000",
    "trainer.window=10000000000000000000000": "trainer.window must be at most 1e+15",
    "env.num_uavs=1000000000": "env.num_uavs must be in [1, 512], got 1000000000",
    "buffer.capacity=100000000000": "for buffer.capacity=100000000000, and this machine has",
    "algo.hidden=[1000000,1000000]": "for algo.hidden=[1000000, 1000000], and this machine has",
    "algo.batch_size=1000000000": "lower algo.batch_size.",
    "lifeguard=linear lifeguard.capacity=100000000000": "lower lifeguard.capacity.",
    "fork=on fork.system_network.hidden=[1000000,1000000]": "lower fork.system_network.hidden.",
}


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A folder with a reward of one's own, which leaves out what its class takes, and with a file that nobody chose."""
    folder = tmp_path / "my yaml's"
    (folder / "reward").mkdir(parents=True)
    (folder / "reward" / "bold.yaml").write_text(
        "_target_: uavrl.transforms.rewards.TraditionalReward\ncollided_reward: -50.0\nboldness: 1.0\n"
    )
    (folder / "reward" / "broken.yaml").write_text("weights: [1.0\n")
    (folder / "reward" / "egg.yaml").write_text("defaults: [hen]\n")
    (folder / "reward" / "hen.yaml").write_text("defaults: [egg]\n")
    (folder / "reward" / "empty.yaml").write_text("defaults:\n")
    monkeypatch.chdir(tmp_path)
    return ["--config-dir", str(folder)]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["reward=bold", "reward.arrived_reward=100"],
            "belongs to reward=navigation or reward=navigation_printed or reward=navigation_prize or "
            "reward=traditional: add one of them to the command, even if a run was trained with it, or write "
            "+reward.arrived_reward=VALUE where the class",
        ),
        (
            ["reward=traditional", "reward.boldness=2"],
            "reward.boldness belongs to reward=bold: add that to the command, even if a run was trained with it, or "
            "write +reward.boldness=VALUE where",
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
        (
            ["env.world.file=site.stl"],
            "env.world.file belongs to env=cloud or env=mesh: add one of them to the command, even",
        ),
        (
            ["env=forest", "env.world.traps=3"],
            "env.world.traps belongs to env=dynamic or env=static: add one of them",
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
            "policy must be one of straight, vfh, vfh_mapped, vfh_mapped_traps, vfh_privileged, vfh_star, mppi, "
            "potential_field, rrt_connect, rrt_map, best, best_dynamic, got 'bst': did you mean best?",
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


@pytest.mark.parametrize("arguments", MISTAKES)
def test_a_mistake_is_one_sentence_and_leaves_no_folder(
    arguments: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert MISTAKES[arguments] in refused(train_command.main, *arguments.split())
    assert not list(tmp_path.iterdir())


def test_a_mistake_found_after_the_folder_was_made_leaves_none(tmp_path: Path, refused: Callable[..., str]) -> None:
    run_dir = tmp_path / "runs" / "new" / "run"
    assert "CUDA devices" in refused(train_command.main, *TINY, "device=cuda:99", f"run_dir={run_dir}")
    assert not (tmp_path / "runs").exists()
    run_dir.mkdir(parents=True)
    (run_dir / "mine.txt").write_text("kept")
    assert "CUDA devices" in refused(train_command.main, *TINY, "device=cuda:99", f"run_dir={run_dir}")
    assert (run_dir / "mine.txt").read_text() == "kept"
