"""``--help`` fits a screen, explains the most common keys, and lists all on demand."""

from __future__ import annotations

import re

import pytest
from omegaconf import OmegaConf

from tests.helpers.commands import in_process
from tests.helpers.configs import composed
from uavrl.cli import evaluate, main, replay, train
from uavrl.cli.help import ABOUT, help_text
from uavrl.cli.keys import known_keys


@pytest.mark.parametrize("name", ABOUT)
def test_help_fits_a_screen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    lines = help_text(name).splitlines()
    assert len(lines) <= 50 and max(map(len, lines)) <= 100
    assert all(any(line.startswith(f"  {key} ") for line in lines) for key in ABOUT[name].most_used.split())


@pytest.mark.parametrize("name", ["config", "evaluate"])
def test_every_key_is_explained_in_full_help(name: str) -> None:
    told = {line.split()[0] for line in help_text(name, every_key=True).splitlines() if line.startswith("  ")}
    parts = {key.rpartition(".")[0] for key in known_keys(name)}  # what holds other keys needs no comment of its own
    rows = ("reward_preset", "learner", "experiment", "preset", "actor_penalty", "defaults", "hydra")
    expected = {key for key in known_keys(name) if key not in parts and key.partition(".")[0] not in rows}
    groups = {key.partition(".")[0] for key in known_keys(name) if "." in key}
    assert sorted(expected - groups - told) == []


@pytest.mark.parametrize(
    ("name", "key", "default"),
    [
        ("sitl", "perception.lidar.max_range", "100"),  # its own, where the perception's is 4 m
        ("sitl", "env.world.planes", "0"),
        ("evaluate", "perception.statistic", "face"),
        ("config", "algo.policy_delay", "2"),  # TD3's, where DDPG and SAC have 1
        ("config", "reward.arrived_reward", "200.0"),
    ],
)
def test_full_help_tells_the_default_of_the_default_choice(name: str, key: str, default: str) -> None:
    assert str(OmegaConf.select(composed(name), key)) == default
    rows = re.split(r"\n  (?=\S)", help_text(name, every_key=True))
    (row,) = (row for row in rows if row.split()[0] == key)
    assert row.split()[-1] == f"({default})"


def test_what_is_asked_for_is_shown_and_nothing_else_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    for command in (train, evaluate, replay):
        assert in_process(command.main, "--help", "env=nonsense") == 0
        assert "Most common keys" in capsys.readouterr().out


def test_one_name_for_all_commands(capsys: pytest.CaptureFixture[str]) -> None:
    def said(*arguments: str, code: int = 0) -> str:
        assert in_process(main.main, *arguments) == code
        return "".join(capsys.readouterr())

    commands = "train evaluate compare replay report export scan check fly sitl pretrain"
    assert set(main.COMMANDS) == set(commands.split())
    assert said("train", "--help").startswith("uavrl-train: Trains one policy")
    assert said("--version").split()[0] == "uavrl"
    assert said("train", "--version") == said("--version")  # and not Hydra's
    assert said("trian", code=1) == "uavrl: There is no command 'trian': did you mean train?\n"
    assert "did you mean trainer.episodes?" in said("train", "trainer.epsodes=3", code=1)


def test_another_help_is_refused_with_those_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(train.main, "--help=al") == 1
    told = "uavrl: uavrl-train has no --help=al: --help shows the most common keys, and --help=all shows all keys.\n"
    assert capsys.readouterr().err == told
