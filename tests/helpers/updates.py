"""Transitions of a small world, for updates that two implementations make side by side."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor

from tests.helpers import oracle

FRAME, STATE, ACTIONS = 3, 6, 2  # the state is two frames, the last one at its end


def transitions(size: int, seed: int, noise: float) -> TensorDict:
    """Random transitions of a linear world; some end by a collision, some by the clock, which bootstraps."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(width: int) -> Tensor:
        return 2 * torch.rand(size, width, generator=generator, dtype=torch.float32) - 1

    state, action = uniform(STATE), 2 * uniform(ACTIONS)
    mix = torch.linspace(-0.5, 0.5, (FRAME + ACTIONS) * FRAME).reshape(FRAME + ACTIONS, FRAME).to(state)
    disturbance = noise * torch.randn(size, FRAME, generator=generator, dtype=torch.float32)
    frame = torch.cat([state[:, FRAME:], action], -1) @ mix + disturbance
    reward = (8 * (state[:, :1] - action[:, :1] * frame[:, :1])).round() / 8  # exact in single precision, summed too
    row = torch.arange(size)[:, None]
    terminated, truncated = row % 7 == 3, row % 5 == 4
    following = {
        "observation": torch.cat([state[:, FRAME:], frame], -1),
        "reward": reward,
        "done": terminated | truncated,
        "terminated": terminated,
        "truncated": truncated,
    }
    return TensorDict({"observation": state, "action": action, "next": following}, [size])


def episodes(seed: int, count: int = 30, steps: int = 5) -> TensorDict:
    """Whole episodes, end to end; two in three collide, where the last frame is large, and one arrives.

    They see little of the world, so that FORK's range cuts many predictions.
    """
    data = transitions(count * steps, seed, 0.1)
    for state in (data["observation"], data["next", "observation"]):
        state *= 0.25
    data["next", "reward"].add_(0.5 + seed / 80)  # later episodes fare better
    row = torch.arange(count * steps)
    last = row % steps == steps - 1
    arrived = last & ((row // steps) % 3 == 0)
    collided = last & ~arrived
    data["observation"][:, FRAME:] += 1.5 * collided[:, None]
    data["next"].update(
        {"done": last[:, None], "collided": collided[:, None], "arrived": arrived[:, None], "terminated": last[:, None]}
    )
    return data


def batch_number(update: int, size: int = 32) -> TensorDict:
    """The batch of one update. Some are so noisy that no model predicts them."""
    noisy = (update * 7919) % 11 < 5
    return transitions(size, 1000 + update, 1.5 if noisy else 0.02)


def cast(data: TensorDict) -> TensorDict:
    dtype = torch.get_default_dtype()
    return data.apply(lambda value: value.to(dtype) if value.is_floating_point() else value)


def plain(data: TensorDict) -> oracle.Batch:
    following = data["next"]
    return oracle.Batch(
        data["observation"].clone(),
        data["action"].clone(),
        following["reward"].clone(),
        following["observation"].clone(),
        following["terminated"].clone(),
    )
