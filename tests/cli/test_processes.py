"""Results of processes are handed over as they are complete; the first error ends all."""

from __future__ import annotations

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import pytest

from uavrl.cli.processes import as_complete, processes
from uavrl.errors import UavrlError

KILLED = "A process was killed: start it again."


@pytest.fixture(autouse=True)
def _looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavrl.cli.processes.EVERY", 0.01)


def futures(count: int) -> list[Future[Any]]:
    return [Future() for _ in range(count)]


def test_what_is_complete_first_comes_first() -> None:
    made = {"one": futures(2), "other": futures(1)}
    made["one"][1].set_result("b")
    made["other"][0].set_result("c")
    found = as_complete(made, (), lambda: made["one"][0].done() or made["one"][0].set_result("a"))
    assert sorted(found) == [("one", ["a", "b"]), ("other", ["c"])]


def test_a_result_is_not_held_back_by_one_that_was_begun_before() -> None:
    made = {"one": futures(1), "other": futures(1)}
    made["other"][0].set_result("c")
    found = as_complete(made, (), lambda: None)
    assert next(found) == ("other", ["c"])
    made["one"][0].set_result("a")
    assert list(found) == [("one", ["a"])]


@pytest.mark.parametrize(
    ("name", "error", "told"),
    [
        ("dense", UavrlError("It has no map."), "dense: It has no map."),
        ("", UavrlError("It has no map."), "It has no map."),
    ],
)
def test_an_error_is_told_at_once_although_others_go_on(name: str, error: Exception, told: str) -> None:
    made = {"other": futures(1), name: futures(2)}
    made[name][1].set_exception(error)
    with pytest.raises(UavrlError) as raised:
        list(as_complete(made, (), lambda: None))
    assert str(raised.value) == told


def test_another_error_stays_what_it_is() -> None:
    (made,) = futures(1)
    made.set_exception(ZeroDivisionError("of a policy"))
    with pytest.raises(ZeroDivisionError):
        list(as_complete({"": [made]}, (), lambda: None))


def test_a_killed_process_is_told_with_a_sentence() -> None:
    with pytest.raises(UavrlError, match=r"^A process was killed: start it again\.$"), processes(1, KILLED):
        raise BrokenProcessPool("terminated abruptly")
