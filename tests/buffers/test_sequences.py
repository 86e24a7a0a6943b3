"""Windows of whole episodes: which steps they hold, and how much each counts."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from uavrl.buffers import EpisodeBuffer, MultiStep, Windows
from uavrl.buffers.sequences import EPISODE, WEIGHT, numbered
from uavrl.training.replay import EpisodeReplay
from uavrl.transforms import Mirror


def episodes(*lengths: int, first: float = 0.0) -> TensorDict:
    """Episodes whose observations count on, 100 apart; the reward of a step is that of its observation."""
    begins = [first + 100.0 * number for number in range(len(lengths))]
    seen = torch.cat([begin + torch.arange(n) for begin, n in zip(begins, lengths, strict=True)])[:, None]
    done = torch.cat([torch.arange(n) == n - 1 for n in lengths])[:, None]
    after = {"observation": seen + 1, "reward": seen.clone(), "done": done, "terminated": done}
    flags = {"arrived": done, "collided": ~done & done}
    return TensorDict({"observation": seen, "action": seen.clone(), "next": {**after, **flags}}, [len(seen)])


def replay(*lengths: int, capacity: int = 1000, n_steps: int = 1, burn_in: int = 2, length: int = 3) -> EpisodeReplay:
    transform = MultiStep(n_steps, 1.0) if n_steps > 1 else None
    made = EpisodeReplay(
        EpisodeBuffer(capacity, transform=transform), 2000 * length, windows=Windows(burn_in, length, n_steps)
    )
    made.store(made.filtered(episodes(*lengths)))
    return made


def drawn(made: EpisodeReplay) -> TensorDict:
    torch.manual_seed(0)
    (batch,) = made.batches(1)
    assert isinstance(batch, TensorDict)
    return batch


@pytest.mark.parametrize("n_steps", [1, 3])
@pytest.mark.parametrize("lengths", [(7, 1, 2, 12), (9,), (2, 2)])
def test_the_states_of_a_transition_are_at_their_places_in_the_window(lengths: tuple[int, ...], n_steps: int) -> None:
    batch = drawn(replay(*lengths, n_steps=n_steps))
    seen, steps = batch["seen"][..., 0], batch["steps"]
    counts = steps[WEIGHT] > 0
    assert torch.equal(seen.gather(1, steps["now"])[counts], steps["observation"][..., 0][counts])
    assert torch.equal(seen.gather(1, steps["then"])[counts], steps["next", "observation"][..., 0][counts])


@pytest.mark.parametrize("n_steps", [1, 3])
def test_a_window_knows_what_came_before_in_its_episode_alone(n_steps: int) -> None:
    batch = drawn(replay(7, 1, 2, 12, burn_in=2, n_steps=n_steps))
    seen, steps = batch["seen"][..., 0], batch["steps"]
    for row, places, counts in zip(seen, steps["now"], steps[WEIGHT] > 0, strict=True):
        used = row[: places[counts].max() + 1]
        assert (used.diff() == 1).all(), "consecutive steps of one episode"
        first = row[places[counts][0]]
        assert places[counts][0] == min(2, first % 100), "as many before as there are, two at most"


def test_each_step_of_all_episodes_counts_as_much_as_the_next() -> None:
    batch = drawn(replay(7, 1, 2, 12))
    names, weights = batch["steps", "observation"].flatten().int(), batch["steps", WEIGHT].flatten()
    counted = torch.stack([weights[names == name].sum() for name in names.unique()])
    assert len(counted) == 22
    torch.testing.assert_close(counted / counted.mean(), torch.ones(22), atol=0.2, rtol=0)


def test_a_full_buffer_forgets_the_beginning_of_an_episode_first() -> None:
    made = replay(6, 6, capacity=9)
    batch = drawn(made)
    seen = batch["steps", "observation"].flatten()[batch["steps", WEIGHT].flatten() > 0]
    assert sorted(seen.unique().tolist()) == [3.0, 4.0, 5.0, *(100.0 + step for step in range(6))]
    made.store(made.filtered(episodes(4, first=500.0)))
    batch = drawn(made)
    seen = batch["steps", "observation"].flatten()[batch["steps", WEIGHT].flatten() > 0]
    assert sorted(seen.unique().tolist()) == [
        *(101.0 + step for step in range(5)),
        *(500.0 + step for step in range(4)),
    ]


def test_the_numbers_of_episodes_go_on_after_a_checkpoint() -> None:
    made = replay(3, 4)
    other = replay(1)
    other.load_state_dict(made.state_dict())
    assert other.stored_episodes == 2
    data, following = numbered(episodes(2, 1), other.stored_episodes)
    assert data[EPISODE].tolist() == [[2, 0], [2, 1], [3, 0]] and following == 4


def test_a_window_is_mirrored_whole() -> None:
    """Cells of a whole window are all those of the image, or none: a memory has no mirror image of its own."""
    cells = torch.rand(40, 35)
    data = episodes(20, 20).set("action", torch.ones(40, 4))
    data.set("observation", cells).set(("next", "observation"), cells.roll(-1, 0))
    buffer = EpisodeBuffer(100, transform=Mirror())
    made = EpisodeReplay(buffer, 300, windows=Windows(4, 3))
    made.store(made.filtered(data))
    batch = drawn(made)
    mirrored = (batch["steps", "action"][..., 1] < 0).any(-1)
    assert 20 < mirrored.sum() < 80
    assert torch.equal(mirrored, (batch["steps", "action"][..., 1] < 0).all(-1))
    altitude_and_cells = {row.tobytes() for row in cells.numpy()}
    unchanged = torch.tensor(
        [all(row.numpy().tobytes() in altitude_and_cells for row in seen) for seen in batch["seen"]]
    )
    assert torch.equal(unchanged, ~mirrored)
