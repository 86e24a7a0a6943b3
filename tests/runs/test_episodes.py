"""``episodes.csv``: what is written, and what is read again."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from uavrl.errors import UavrlError
from uavrl.runs.episodes import Episode, EpisodeLog, read_episodes, split_episodes


def row(number: int, outcome: str = "arrived") -> Episode:
    return Episode(number, 10 * number, outcome, -1.5 * number, 10, 0.1, 0.2, 0.3, 4.0, 5.0, 6.0, 7, number)


def test_the_log_cuts_its_file_back_to_the_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    log = EpisodeLog(path, window=2)
    for number in (1, 2, 3):
        log.add(row(number))
    state, whole = log.state_dict(), path.read_bytes()
    for number in (4, 5):
        log.add(row(number, "collided"))
    with path.open("a") as file:
        file.write("6,60,arr")
    other = EpisodeLog(path, window=2)
    other.load_state_dict(state)
    assert path.read_bytes() == whole
    assert read_episodes(path) == [row(1), row(2), row(3)]
    assert (other.count, other.rates()["arrived"], other.mean_return()) == (3, 1.0, -3.75)
    other.add(row(4, "timed_out"))
    assert other.rates() == {"arrived": 0.5, "collided": 0.0, "timed_out": 0.5}
    assert [e.episode for e in read_episodes(path)] == [1, 2, 3, 4]


def test_the_log_keeps_what_each_term_of_the_reward_adds(tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    log = EpisodeLog(path, window=2)
    paid = [{"progress": 1.0, "arrival": 0.0}, {"progress": 2.5, "arrival": 200.0}, {"progress": 3.5, "arrival": 0.0}]
    rows = [replace(row(number), terms=terms) for number, terms in enumerate(paid, start=1)]
    for each in rows:
        log.add(each)
    assert path.read_text().splitlines()[0].endswith(",task,return_progress,return_arrival")
    assert read_episodes(path) == rows
    assert log.mean_terms() == {"progress": 3.0, "arrival": 100.0}
    other = EpisodeLog(path, window=2)
    other.load_state_dict({"count": 2})
    assert other.mean_terms() == {"progress": 1.75, "arrival": 100.0}
    other.add(rows[2])
    assert read_episodes(path) == rows


def test_the_first_row_decides_which_terms_there_are(tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    EpisodeLog(path).add(row(1))
    log = EpisodeLog(path)
    log.load_state_dict({"count": 1})
    log.add(replace(row(2), terms={"progress": 1.0}))
    assert read_episodes(path) == [row(1), row(2)]
    assert log.mean_terms() == {}
    with_terms = EpisodeLog(tmp_path / "other.csv")
    with_terms.add(replace(row(1), terms={"progress": 1.0}))
    with_terms.add(row(2))
    assert math.isnan(read_episodes(with_terms.path)[1].terms["progress"])


def test_the_terms_of_a_runs_returns_are_logged_beside_them(finished: Path) -> None:
    episodes = read_episodes(finished / "episodes.csv")
    for episode in episodes:
        assert list(episode.terms) == ["progress", "altitude", "heading", "elevation", "arrival", "collision"]
        assert sum(episode.terms.values()) == pytest.approx(episode.episode_return, abs=1e-4)


@pytest.mark.parametrize("terms", [{}, {"progress": 1.0}])
def test_a_row_of_another_length_is_damage(terms: dict[str, float], tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    EpisodeLog(path).add(replace(row(1), terms=terms))
    with path.open("a") as file:
        file.write("2,20,arrived,5.0\n")
    with pytest.raises(UavrlError, match=r"episodes\.csv is damaged: expected rows of 1\d columns, got 4 in one"):
        read_episodes(path)


def test_the_log_refuses_a_file_that_is_too_short(tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    log = EpisodeLog(path)
    log.add(row(1))
    before = path.read_bytes()
    with pytest.raises(UavrlError, match=r"at least 2 episodes .* found 1"):
        EpisodeLog(path).load_state_dict({"count": 2})
    assert path.read_bytes() == before


@pytest.mark.parametrize("done", [[False, True, False], [False], [False, False, True, False]])
def test_half_an_episode_is_refused(done: list[bool]) -> None:
    batch = TensorDict({"next": {"done": torch.tensor(done)[:, None]}}, [len(done)])
    with pytest.raises(ValueError, match="whole episodes"):
        list(split_episodes(batch))
