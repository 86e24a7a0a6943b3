"""The policy's success in unseen valleys while it trains, and the end of a run by it."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from torch import nn

from tests.helpers.runs import contents, logged, small_config
from uavrl.config import validate
from uavrl.errors import UavrlError
from uavrl.evaluation.sequential import has_exceeded
from uavrl.runs.checkpoint import rotation
from uavrl.training import build
from uavrl.training.build import build_trainer
from uavrl.training.run import create_run, train
from uavrl.training.validation import HereFlier, Validated, Validation, Weights

UNSEEN = ["validation=unseen", "validation.interval=60", "validation.tasks=3", "validation.seeds=[7,8]"]
LENGTH = ["trainer.episodes=16", "logger.interval=1"]


class Answers:
    """Rolls out nothing: gives successes that are written down, each when it has been asked for often enough."""

    def __init__(self, successes: list[int], asked: int = 1) -> None:
        self.left, self.asked = successes, asked
        self.begun: list[tuple[float, int, int]] = []
        self._waits = 0

    def begin(self, weights: Weights, tasks: int, seed: int) -> None:
        self.begun.append((weights["weight"].item(), tasks, seed))
        self._waits = self.asked

    def successes(self) -> int | None:
        self._waits -= 1
        return None if self._waits else self.left.pop(0)

    def close(self) -> None:
        pass


def made(answers: Answers, policy: nn.Module | None = None, **options: float) -> Validation:
    return Validation(lambda seeds: answers, policy or nn.Linear(1, 1, bias=False), 0, **options)  # type: ignore[arg-type]


def test_a_validation_comes_every_so_many_steps_with_new_tasks_and_the_weights_of_then() -> None:
    policy = nn.Linear(1, 1, bias=False)
    answers = Answers([5, 9, 20])
    validation = made(answers, policy, interval=100)
    for steps in range(0, 360, 40):
        with torch.no_grad():
            policy.weight.fill_(steps)
        validation.advance(steps)
    assert validation.found == [Validated(120, 20, 5), Validated(240, 20, 9)]
    assert [begun[:2] for begun in answers.begun] == [(120.0, 20), (240.0, 20)]
    assert answers.begun[0][2] != answers.begun[1][2], "the same tasks again"
    assert made(Answers([]), interval=100).advance(99) is None


def test_the_run_learns_on_while_a_validation_takes_its_time() -> None:
    answers = Answers([18, 18], asked=3)
    validation = made(answers, interval=10)
    found = [validation.advance(steps) for steps in (10, 20, 30, 40)]
    assert found == [None, None, Validated(10, 20, 18), None]
    assert len(answers.begun) == 2


def test_a_promising_one_is_followed_by_the_next_at_once() -> None:
    validation = made(Answers([18, 20, 20, 10, 20]), interval=100)
    for steps in range(0, 310, 10):
        validation.advance(steps, until_success=0.9)
    assert [each.steps for each in validation.found] == [100, 200, 210, 220]


def test_a_verdict_is_that_of_the_sequential_test_and_survives_a_resume() -> None:
    validation = made(Answers([20] * 9), interval=1)
    verdicts = []
    for steps in range(1, 10):
        validation.advance(steps)
        verdicts.append(validation.reached(0.95))
    assert verdicts == [has_exceeded(0.95, [(20, 20)] * count) for count in range(1, 10)]
    assert verdicts[0] is False and verdicts[-1] is True
    again = made(Answers([]), interval=1)
    again.load_state_dict(validation.state_dict())
    assert again.found == validation.found and again.advance(9) is None
    assert not made(Answers([])).reached(0.01), "nothing was flown"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same training without validations and with them."""
    folder = tmp_path_factory.mktemp("validated")
    for name, more in (("without", []), ("with", UNSEEN)):
        config = small_config(folder / name, *LENGTH, *more)
        train(config, create_run(config))
    return folder / "without", folder / "with"


def test_validations_change_nothing_of_what_is_learned(runs: tuple[Path, Path]) -> None:
    without, validated = runs
    assert (without / "episodes.csv").read_bytes() == (validated / "episodes.csv").read_bytes()
    before, after = (contents(rotation(run).latest()) for run in runs)
    learned = [name for name in before if "-trainer/" not in name and "-log/" not in name]
    assert len(learned) > 30
    assert not [name for name in learned if before[name] != after[name]]
    values = logged(validated)
    assert values.pop("success_unseen.csv")
    assert values == logged(without)


def test_they_are_logged_at_the_steps_that_the_policy_had(runs: tuple[Path, Path]) -> None:
    with (runs[1] / "episodes.csv").open(encoding="utf-8") as file:
        ends = [int(row["total_steps"]) for row in csv.DictReader(file)]
    due: list[int] = []
    for steps in ends[:-1]:
        due += [steps] if steps - (due[-1] if due else 0) >= 60 else []
    rows = [row.split(",") for row in logged(runs[1])["success_unseen.csv"].decode().splitlines()]
    assert [int(step) for step, _ in rows] == due and len(due) > 1
    assert all(float(value) * 3 == pytest.approx(round(float(value) * 3), abs=1e-5) for _, value in rows)


def test_a_run_ends_once_its_policy_is_good_enough_and_stays_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(HereFlier, "begin", lambda *_: None)
    monkeypatch.setattr(HereFlier, "successes", lambda _: 3)
    more = ["trainer.until_success=0.5", "trainer.episodes=300"]
    config = small_config(tmp_path / "run", *UNSEEN, *more)
    with caplog.at_level("INFO"):
        summary = train(config, create_run(config))
    looks = [(each["successes"], each["tasks"]) for each in summary["validations"]]
    assert summary["reached_success"] is True and summary["episodes"] < 300
    assert has_exceeded(0.5, looks) and not has_exceeded(0.5, looks[:-1])
    assert "has exceeded a success rate of 50 % in unseen valleys" in caplog.text
    again = train(config, tmp_path / "run", resume=True)
    assert again["episodes"] == summary["episodes"], "a run that has ended is not flown on"
    config.trainer.until_success = None
    config.trainer.episodes = summary["episodes"] + 2
    assert train(config, tmp_path / "run", resume=True)["episodes"] == summary["episodes"] + 2


def test_a_success_rate_without_validations_is_refused(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "trainer.until_success=0.9")
    with pytest.raises(UavrlError, match=r"validation must be unseen, which measures the success rate that ends the"):
        build_trainer(validate(config), config, create_run(config))


def test_valleys_of_the_training_are_left_out_and_others_are_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[tuple[int, ...]] = []
    monkeypatch.setattr(build, "make_flight", lambda *_: None)
    monkeypatch.setattr(build, "_in_valleys", recording(build._in_valleys, flown))
    for name, seeds in (("some", "[0,7]"), ("none", "[0]")):
        config = small_config(tmp_path / name, "validation=unseen", f"validation.seeds={seeds}")
        if name == "some":
            build_trainer(validate(config), config, create_run(config)).collector.shutdown()
            continue
        with pytest.raises(UavrlError, match=r"validation\.seeds must be seeds of valleys in which the run does not"):
            build_trainer(validate(config), config, create_run(config))
    assert flown == [(7,)]


def recording(in_valleys: object, flown: list[tuple[int, ...]]) -> object:
    def recorded(*args: object) -> object:
        settings = in_valleys(*args)  # type: ignore[operator]
        flown.append(settings.env.world.seeds)
        return settings

    return recorded


def test_it_flies_as_an_evaluation_does(tmp_path: Path) -> None:
    """Vehicles are the nominal ones, and all valleys have the first of the training's numbers of obstacles."""
    more = ["randomize=real", "env.world.seeds=[0,1]", "env.world.obstacles=[3,6]", *UNSEEN]
    config = small_config(tmp_path / "run", *more)
    trainer = build_trainer(validate(config), config, create_run(config))
    try:
        assert trainer.validation is not None
        trainer.validation.advance(60)
        flier = trainer.validation._flier
        assert isinstance(flier, HereFlier) and flier._flight is not None
        base = flier._flight.env.base_env
        assert base.randomize is None
        assert (base.world.config.seeds, base.world.config.obstacles) == ((7, 8), 3)
    finally:
        trainer.validation.close()
        trainer.collector.shutdown()
