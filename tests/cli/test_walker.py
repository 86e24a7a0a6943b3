"""The commands on a run of the bipedal walker."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from tests.helpers.finished import finished_run
from uavrl.cli import evaluate, replay
from uavrl.reporting.report import make_report
from uavrl.runs.episodes import read_episodes

TINY = [
    "env=bipedal_hardcore",
    "trainer.episodes=8",
    "env.max_steps=90",  # some fall before, some do not
    "algo.random_steps=1000",  # all of them, so that no last digit of a network decides how a walk ends
    "algo.hidden=[8]",
    "buffer.capacity=400",
    "trainer.progress=false",
    "trainer.execution=captured",
    "trainer.products=mkl",  # `auto` could turn with the process
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finished_run(tmp_path_factory.mktemp("runs") / "run", *TINY)


def test_evaluation_walks_the_same_courses_again(finished: Path) -> None:
    results = []
    for _ in range(2):
        assert in_process(evaluate.main, f"run={finished}", "episodes=2", "progress=false") == 0
        results.append(json.loads((finished / "evaluation_episodes=2.json").read_text()))
    assert results[0] == results[1]
    assert [walk["task"] for walk in results[0]["flights"]] == [0, 1]
    returns = [walk["episode_return"] for walk in results[0]["flights"]]
    assert results[0]["mean_return"] == pytest.approx(sum(returns) / 2)
    assert results[0]["env"] == "bipedal_hardcore" and "valleys" not in results[0]


def test_returns_are_recorded_as_gymnasium_gives_them(finished: Path) -> None:
    """A walker of 90 steps cannot earn or lose 60 but by a fall, which is -5 among the scaled rewards."""
    episodes = read_episodes(finished / "episodes.csv")
    assert {episode.outcome for episode in episodes} == {"collided", "timed_out"}
    for episode in episodes:
        assert (episode.outcome == "collided") == (episode.episode_return < -60)


@pytest.mark.parametrize(
    ("main", "overrides", "told"),
    [
        (replay.main, [], "shows flights in the valley"),
        (evaluate.main, ["valleys=[1]"], "valleys is for the valley, and the environment is bipedal_hardcore"),
        (evaluate.main, ["env=static"], "The policy reads 'observation', which NavigationEnv does not emit"),
    ],
)
def test_what_only_the_valley_has_is_refused(
    finished: Path, capsys: pytest.CaptureFixture[str], main, overrides: list[str], told: str
) -> None:
    assert in_process(main, f"run={finished}", *overrides) == 1
    message = capsys.readouterr().err
    assert told in message and message.count("\n") == 1


def test_a_walker_without_a_run_needs_a_policy_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(evaluate.main, "policy=straight", "env=bipedal_hardcore") == 1
    assert "policy is for the valley" in capsys.readouterr().err


def test_a_walkers_run_is_reported(finished: Path) -> None:
    report = make_report([finished])
    assert report.title == "Training runs of the hard-core bipedal walker"
    assert [group["label"] for group in report.groups] == ["TD3, walker"]
