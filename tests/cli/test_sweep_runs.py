"""What a sweep's runs became is known to the process of its command, whichever process trained them."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest
from hydra.core.singleton import Singleton

from uavrl.cli import sweep_runs, train
from uavrl.cli.sweep_runs import Outcome

A, B, C = Path("a"), Path("b"), Path("c")


@pytest.fixture(autouse=True)
def _new_sweep() -> Iterator[None]:
    sweep_runs.forget()
    yield
    sweep_runs.forget()


def test_an_outcome_is_noted_where_it_is_unpickled() -> None:
    sent = [pickle.dumps(Outcome(run, place, run != B)) for place, run in enumerate((C, B, A))]
    sweep_runs.forget()  # as in another process
    for outcome in reversed(sent):
        pickle.loads(outcome)
    assert sweep_runs.runs(ended=True) == [C, A], "in the sweep's order"
    assert sweep_runs.runs(ended=False) == [B]


def test_a_process_that_a_launcher_starts_knows_which_runs_had_ended() -> None:
    """Hydra's launchers hand its singletons on."""
    Outcome(A, 0, ended=True)
    Outcome(B, 1, ended=False)
    instances = Singleton.get_state()["instances"]
    known = pickle.dumps({kind: each for kind, each in instances.items() if kind.__module__ == sweep_runs.__name__})
    sweep_runs.forget()  # as in another process
    before = Singleton._instances
    try:
        Singleton._instances = before | pickle.loads(known)
        assert sweep_runs.was_ended(A) and not sweep_runs.was_ended(B)
    finally:
        Singleton._instances = before
    assert not sweep_runs.was_ended(A)


def test_a_run_that_has_ended_stays_so_whoever_finds_it_held_later() -> None:
    Outcome(A, 0, ended=False)
    assert not sweep_runs.was_ended(A)
    Outcome(A, 0, ended=True)
    Outcome(A, 0, ended=False)
    assert sweep_runs.was_ended(A) and sweep_runs.runs(ended=False) == []


def test_a_folder_of_two_combinations_is_found_and_one_that_is_looked_at_again_is_not() -> None:
    Outcome(A, 0, ended=True)
    assert sweep_runs.has_another_place(A, 1)
    assert not sweep_runs.has_another_place(A, 0) and not sweep_runs.has_another_place(B, 1)


def test_a_folder_of_two_combinations_is_told_whichever_processes_trained_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of the two found that another process trains there."""

    def launched() -> None:
        for place, run, ended in ((1, A, False), (0, A, True), (2, B, True)):
            Outcome(run, place, ended)

    monkeypatch.setattr(train, "_command", launched)
    with pytest.raises(SystemExit) as end:
        train.main()
    assert end.value.code == 1
    assert capsys.readouterr().err.startswith(
        "uavrl: Two combinations of the sweep have the same run folder a, because"
    )
