"""Recorded scans, states and actions, by which packaged policies are tested on any processor.

An episode cannot be repeated on another processor: it amplifies the last digits of every product of its policy. A
single action, reduction or observation does not. So these are kept, of real episodes:

- ``uavrl/policies/data/NAME/recorded.safetensors``: states of the policy's episodes, and its actions in them;
- ``tests/transforms/scans.safetensors``: the first scans of some episodes, and the states that are made of them.

    python -m tests.helpers.recorded    # writes all of them anew, after a reduction was changed on purpose

`tools/package_policy.py` writes those of a policy that it packages.
"""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, Transform, TransformedEnv

from uavrl.config import TrainConfig, compose, validate
from uavrl.config.build import build
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.overrides import with_overrides
from uavrl.evaluation.policies import PACKAGED, packaged_policies
from uavrl.evaluation.rollout import rollout
from uavrl.policy_protocol import Acts
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl.transforms.range_image import range_image

SCANS = Path(__file__).resolve().parent.parent / "transforms" / "scans.safetensors"
VEHICLES, STEPS = 8, 120  # of which states are recorded
LARGEST = 180_000  # bytes of a policy's states and actions
SCANNED, RETURNS = 6, 200  # steps of an episode, and of each the returns that are kept
MARGIN = 1e-4  # m: returns nearer to a border between cells are left out, since rounding decides on their cell
READ = ("altitude", "heading_deg", "elevation_deg")  # beside the cloud, by what makes the state
# What the recorded scans are read by: the default, and what the packaged policies see.
PERCEPTIONS = {
    "truncated_icosahedron": (),
    "range_image": ("perception=range_image", "perception.last_action=true"),
}


def suite(name: str) -> dict[str, Any]:
    """What the suite found of a packaged policy."""
    return json.loads((PACKAGED / name / "suite.json").read_text())


def evaluation(name: str) -> dict[str, Any]:
    """What it found in the default valley, by which a policy is tested."""
    return suite(name)["static"]


def as_evaluated(name: str) -> tuple[TrainConfig, Acts]:
    """A packaged policy, and the configuration in which its evaluation was flown."""
    policy = read_policy(PACKAGED / name)
    overrides = evaluation(name)["overrides"]
    return validate(with_overrides(policy.config, compose(*overrides, name="evaluate"), overrides)), policy


def recorded(name: str) -> dict[str, Tensor]:
    """``observation`` and ``action`` of a packaged policy's episodes."""
    return load_file(PACKAGED / name / "recorded.safetensors")


class RecordedScans(EnvBase):
    """Emits what was recorded, whatever the action: ``cloud [T, N, P, 3]`` and what goes with it."""

    def __init__(self, scans: dict[str, Tensor]) -> None:
        count, points = scans["cloud"].shape[1:3]
        super().__init__(batch_size=torch.Size([count]))
        entries = {key: Unbounded(shape=(count, 1)) for key in READ}
        flags = {key: Binary(n=1, shape=(count, 1), dtype=torch.bool) for key in ("done", "terminated")}
        self.observation_spec = Composite(
            {"point_cloud": Unbounded(shape=(count, points, 3)), **entries}, shape=(count,)
        )
        self.action_spec = Bounded(-2.0, 2.0, shape=(count, 4))
        self.reward_spec = Unbounded(shape=(count, 1))
        self.done_spec = Composite(flags, shape=(count,))
        self._scans, self._now = scans, 0

    def _observe(self) -> TensorDict:
        data = {key: self._scans[key][self._now] for key in READ}
        no = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        cloud = self._scans["cloud"][self._now]
        return TensorDict({"point_cloud": cloud, **data, "done": no, "terminated": no.clone()}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        self._now = 0
        return self._observe()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._now += 1
        return self._observe().set("reward", torch.zeros(*self.batch_size, 1))

    def _set_seed(self, seed: int | None) -> None:
        pass


def states(scans: dict[str, Tensor], perception: Any) -> Tensor:
    """What a policy reads after each of the recorded scans but the last, ``[T - 1, N, width]``."""
    env = TransformedEnv(RecordedScans(scans), build(perception, Transform, packages=[]))
    actions = iter(scans["action"])
    flown = rollout(env, lambda state: state.set("action", next(actions)), env.reset())
    return torch.stack([stepped["observation"] for stepped in islice(flown, SCANNED - 1)])


def record_actions(name: str) -> None:
    """Writes a packaged policy's states and actions."""
    settings, policy = as_evaluated(name)
    env = make_env(settings.env, settings.perception, seed=evaluation(name)["seed"], num_uavs=VEHICLES)
    try:
        steps = [step.select("observation", "action") for step in islice(rollout(env, policy, env.reset()), STEPS)]
    finally:
        env.close()
    flown = torch.cat(steps)
    rows = LARGEST // (4 * (flown["observation"].shape[-1] + 4))
    chosen = flown[torch.linspace(0, len(flown) - 1, rows).long()]
    kept = {key: chosen[key].clone() for key in ("observation", "action")}
    (PACKAGED / name / "recorded.safetensors").write_bytes(save(kept))


def unmistakable(points: Tensor) -> Tensor:
    """Which points ``[P, 3]`` belong to one cell of either reduction, wherever within the margin they lie."""
    kept = torch.ones(len(points), dtype=torch.bool)
    for reduced in (truncated_icosahedron, range_image):
        cell = reduced(points[:, None], statistic="range") > 0
        kept &= cell.any(-1)
        for shift in (*MARGIN * torch.eye(3), *-MARGIN * torch.eye(3)):
            kept &= ((reduced((points + shift)[:, None], statistic="range") > 0) == cell).all(-1)
    return kept


def _thinned(cloud: Tensor, generator: torch.Generator) -> Tensor:
    """Some of the returns that belong to one cell, ``[RETURNS, 3]``, filled up with misses."""
    returns = cloud[unmistakable(cloud)]
    some = returns[torch.randperm(len(returns), generator=generator)[:RETURNS]]
    return torch.cat([some, torch.full((RETURNS - len(some), 3), torch.nan)])


def _record_scans(name: str = "best") -> None:
    settings, policy = as_evaluated(name)
    seed = evaluation(name)["seed"]
    env = make_env(settings.env, settings.perception, seed=seed, num_uavs=VEHICLES, keep_cloud=True)
    try:
        steps = list(islice(rollout(env, policy, env.reset()), SCANNED))
    finally:
        env.close()
    generator = torch.Generator().manual_seed(0)
    clouds = [torch.stack([_thinned(cloud, generator) for cloud in step["point_cloud"]]) for step in steps]
    scans = {"cloud": torch.stack(clouds)}
    scans |= {key: torch.stack([step[key] for step in steps]) for key in (*READ, "action")}
    for choice, perception in PERCEPTIONS.items():
        scans[choice] = states(scans, validate(compose(*perception)).perception)
    SCANS.write_bytes(save(scans))


if __name__ == "__main__":
    torch.set_num_threads(1)
    for policy_name in packaged_policies():
        record_actions(policy_name)
    _record_scans()
