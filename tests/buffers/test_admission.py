from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from uavrl.buffers import FailureBias, FailureBiasedBuffer, is_admitted
from uavrl.training.replay import Experience


def walk(fell: bool, value: float, steps: int = 4) -> TensorDict:
    last = torch.arange(steps)[:, None] == steps - 1
    after = {
        "observation": torch.zeros(steps, 2),
        "reward": torch.zeros(steps, 1),
        "done": last,
        "terminated": last,
        "arrived": last & (not fell),
        "collided": last & fell,
        "episode_reward": torch.linspace(0, value, steps)[:, None],
    }
    return TensorDict({"observation": torch.zeros(steps, 2), "action": torch.zeros(steps, 1), "next": after}, [steps])


@pytest.mark.parametrize(
    ("value", "fell", "falls", "coin", "stored"),
    [
        (300.0, True, 1, 0.9, True),  # a fall, however far it came
        (249.9, False, 0, 0.9, True),  # no success
        (250.0, False, 0, 0.0, False),  # a success while the counter is not positive
        (250.0, False, -3, 0.0, False),
        (250.0, False, 1, 0.49, True),  # heads
        (250.0, False, 1, 0.5, False),  # tails
    ],
)
def test_which_episodes_are_stored(value: float, fell: bool, falls: int, coin: float, stored: bool) -> None:
    assert is_admitted(value, fell, falls, coin) == stored


def test_the_counter_grows_by_1_a_fall_and_sinks_by_10_a_stored_success() -> None:
    bias = FailureBias(probability=1.0)
    seen = []
    for fell, value in [(True, -90.0), (True, 280.0), (False, 100.0), (False, 300.0), (False, 300.0), (True, 0.0)]:
        seen.append((bias.admits(walk(fell, value)), bias.falls))
    assert seen == [(True, 1), (True, 2), (True, 2), (True, -8), (False, -8), (True, -7)]
    assert bias.diagnostics() == {"buffer_falls": -7.0, "buffer_left_out": 1.0}


def test_half_of_the_successes_are_stored_while_the_counter_is_positive() -> None:
    bias = FailureBias(falls_per_success=0)
    bias.admits(walk(True, 0.0))
    stored = sum(bias.admits(walk(False, 300.0)) for _ in range(1000))
    assert 440 < stored < 560  # four standard deviations


def test_its_state_goes_on_where_it_was() -> None:
    one, other = FailureBias(seed=1), FailureBias(seed=2)
    for _ in range(30):
        one.admits(walk(True, 0.0))
    other.load_state_dict(one.state_dict())
    flips = [[bias.admits(walk(False, 300.0)) for _ in range(20)] for bias in (one, other)]
    assert flips[0] == flips[1] and len(set(flips[0])) == 2


def test_a_missing_return_is_refused() -> None:
    with pytest.raises(KeyError, match="RewardSum"):
        FailureBias().admits(walk(True, 0.0).exclude(("next", "episode_reward")))


def test_after_an_episode_that_is_left_out_come_a_few_updates() -> None:
    experience = Experience(FailureBiasedBuffer(100, updates_when_left_out=7), 2)
    told = []
    for episode in (walk(True, -90.0, 5), walk(False, 300.0, 9), walk(False, 20.0, 3)):
        experience.buffer.admission.falls = 0
        stored = experience.admitted(episode)
        updates = experience.store(stored)
        told.append((len(stored), len(experience.buffer), updates, sum(1 for _ in experience.batches(updates))))
    assert told == [(5, 5, 5, 5), (0, 5, 7, 7), (3, 8, 3, 3)]


def test_nothing_is_learned_from_an_empty_buffer() -> None:
    experience = Experience(FailureBiasedBuffer(9, updates_when_left_out=7), 2)
    assert experience.store(experience.admitted(walk(False, 300.0))) == 0
