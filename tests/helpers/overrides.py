"""Random command lines, and how they end."""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf

from tests.helpers.commands import in_process
from tests.helpers.configs import composed
from uavrl.cli import train as train_command
from uavrl.envs.world import World
from uavrl.training.trainer import EpisodeTrainer

SECONDS = 10.0  # of computing, from the command to its end or its start
SMALL = [
    "env.max_steps=3",
    "algo.learning_starts=0",
    "algo.hidden=[8]",
    "buffer.capacity=400",
    "trainer.episodes=2",
    "trainer.progress=false",
    "trainer.execution=captured",
    "trainer.matmul=mkl",
]
# The asynchronous collector and wandb start processes of their own, and an experiment is a sweep:
# each takes longer than the rest together.
GROUPS = {
    "env": ["static", "dynamic"],
    "perception": ["truncated_icosahedron", "none", "nothing"],
    "reward": ["navigation", "navigation_prize", "traditional", "null"],
    "algo": ["td3", "ddpg", "sac", "ppo"],
    "buffer": ["uniform", "prioritized", "[uniform]"],
    "backward_reward": ["none", "abr", "abr_plus"],
    "reward_preset": ["tr", "abr", "abr_plus", "prize", "best"],
    "fork": ["none", "on", "off"],
    "lifeguard": ["none", "linear", "mlp", "tree"],
    "learner": ["td3_lg", "td3_fork", "ppo"],
    "algo.actor._target_": ["os.system", "uavrl.models.actor_critic.Critic", "torch.nn.Linear", "null"],
    "logger": ["csv", "tensorboard", "mlflow"],
    "collector": ["sync", "threads"],
    "actor_penalty": ["none", "own"],
    "smoothness": ["none", "action_rate"],
    "cloning": ["none", "dagger"],
    "validation": ["none", "unseen"],
    "preset": ["thesis", "slow", "null"],
}
WILD = [
    *("0", "-1", "1", "2", "7", "1e-30", "0.5", "1e3", "1e9", "-1e9", "1e30", "1000000000", "10000000000000000000000"),
    *("nan", "inf", "-inf", "null", "true", "''", "text", "???", "${seed}", "${nowhere}", "${now:", "[", "a b", "é"),
    *("[]", "[0]", "[1,1]", "[1e9,1e9]", "[-1,2]", "[1,2,3]", "[text]", "[[1]]", "{a:1}", "[null]", "auto", "cuda:7"),
]


class Started(BaseException):
    """The run flies."""


def leaves(node: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    for name in node:
        key, value = f"{above}{name}", OmegaConf.to_container(node, resolve=False)[name]
        if isinstance(value, dict):
            yield from leaves(node[name], f"{key}.")
        yield key, value


@cache
def all_keys() -> dict[str, Any]:
    """All keys of all choices, with a value that each may have."""
    found: dict[str, Any] = {}
    for overrides in (
        ["fork=on", "lifeguard=mlp", "backward_reward=abr"],
        ["algo=sac", "backward_reward=abr_plus", "buffer=prioritized", "reward=traditional"],
    ):
        config: DictConfig = composed("config", "run_dir=here", *overrides)
        found |= dict(leaves(config))
    return found


def near(value: Any) -> st.SearchStrategy[str]:
    """Values of the kind of a value."""
    if isinstance(value, bool):
        return st.sampled_from(["true", "false"])
    if isinstance(value, int):
        return st.one_of(st.integers(-1, 9), st.integers(0, max(2 * value, 1))).map(str)
    if isinstance(value, float):
        return st.floats(0, 2 * abs(value) + 1e-3, allow_nan=False).map(str)
    if isinstance(value, list):
        return st.lists(st.one_of(st.integers(-1, 9), st.floats(0, 9)), max_size=4).map(
            lambda v: str(v).replace(" ", "")
        )
    return st.sampled_from([str(value), "other"])


@st.composite
def override(draw: st.DrawFn) -> str:
    if draw(st.integers(0, 3)) == 0:
        group = draw(st.sampled_from(sorted(GROUPS)))
        return f"{group}={draw(st.sampled_from(GROUPS[group]))}"
    key = draw(st.sampled_from(sorted(all_keys())))
    kind = draw(st.integers(0, 19))
    if kind == 0:
        return f"~{key}"
    if kind == 1:  # a slip of the pen
        place = draw(st.integers(0, len(key) - 1))
        key = key[:place] + key[place + 1 :] or "x"
    value = draw(near(all_keys().get(key)) if kind < 12 else st.sampled_from(WILD))
    return f"{'+' if kind == 2 else '++' if kind == 3 else ''}{key}={value}"


def outcome(overrides: list[str]) -> tuple[str, str, float]:
    """How the command ends, what it prints, and how many seconds it computes."""
    out, begin = io.StringIO(), time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            code = in_process(train_command.main, *SMALL, *overrides)
        except Started:
            return "started", out.getvalue(), time.process_time() - begin
    return f"code {code}", out.getvalue(), time.process_time() - begin


@contextlib.contextmanager
def before_the_world() -> Iterator[None]:
    """A run whose world would be built has started, and one without a valley that would be trained."""

    def begin(*_: object) -> None:
        raise Started

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(World, "__init__", begin)
        patch.setattr(EpisodeTrainer, "train", begin)
        yield


def ends_well(overrides: list[str], start: Callable[[], AbstractContextManager[None]]) -> None:
    """Asserts that a command ends in a start, which ``start`` brings about, or in one sentence and without a folder."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, start():
        os.chdir(folder)
        try:
            how, printed, seconds = outcome(overrides)
            left = sorted(str(path) for path in Path(folder).rglob("*"))
        finally:
            os.chdir(before)
    assert "Traceback" not in printed, printed
    assert seconds < SECONDS, seconds
    if how not in ("started", "code 0"):
        assert how in ("code 1", "code 2"), how
        assert not left, left
        told = [line for line in printed.splitlines() if line.startswith("uavrl: ")]
        assert how == "code 2" or len(told) == 1, printed


ANY = st.lists(override(), min_size=1, max_size=4)
TOLD = settings(
    deadline=None, derandomize=True, print_blob=False, database=None, suppress_health_check=list(HealthCheck)
)
