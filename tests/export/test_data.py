"""The data set of a run is what the run flew, and TorchRL reads it where there is no uavrl."""

from __future__ import annotations

import hashlib
import json
import pickle
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tensordict
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import SliceSampler, TensorDictReplayBuffer, TensorStorage

import uavrl
from tests.helpers.folders import ROOT
from tests.helpers.foreign import Payload
from tests.helpers.runs import small_config
from tests.helpers.states import checkpoint_run, walk
from uavrl.config import validate
from uavrl.errors import UavrlError
from uavrl.export.data import export_data
from uavrl.runs.episodes import read_episodes
from uavrl.training.build import build_trainer
from uavrl.training.run import create_run, seed_everything

DEMONSTRATED = [
    *("perception=range_image", "perception.last_action=true", "buffer.mirror=true", "demonstrator=vfh"),
    *("cloning=dagger", "cloning.steps=1000", "cloning.batch_size=8", "cloning.updates_per_step=0.05"),
    *("trainer.episodes=14", "trainer.checkpoint_interval=1000", "trainer.execution=eager", "algo.gamma=0.9"),
    *("env.world.goal_radius=7", "env.max_steps=25"),  # some arrive
]
EXAMPLE = re.search(r"^```python\n(.*?)```", (ROOT / "docs/howto/data.md").read_text(), re.MULTILINE | re.DOTALL)[1]  # type: ignore[index]


def flown(run_dir: Path, *overrides: str) -> list[TensorDictBase]:
    """Trains a run; returns its episodes as they left the collector, before anything was stored."""
    config = small_config(run_dir, *DEMONSTRATED, *overrides)
    settings = validate(config)
    seed_everything(settings.seed)
    trainer = build_trainer(settings, config, create_run(config))
    episodes: list[TensorDictBase] = []
    collect = type(trainer.collector).__iter__

    def recorded(collector: Any) -> Iterator[TensorDictBase]:
        for episode in collect(collector):
            episodes.append(episode.clone())
            yield episode

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(trainer.collector), "__iter__", recorded)
        trainer.save()
        trainer.train()
    trainer.collector.shutdown()
    assert len(episodes) == 14 and len({len(episode) for episode in episodes}) > 1
    return episodes


def expected(episodes: list[TensorDictBase], n_steps: int, gamma: float) -> TensorDict:
    """The transitions of these episodes, worked out step by step."""
    rows = []
    for number, episode in enumerate(episodes):
        for step in range(len(episode)):
            ahead = min(n_steps, len(episode) - step)
            after = episode[step + ahead - 1]["next"]
            rewards = [episode[step + i]["next", "reward"].double() * gamma**i for i in range(ahead)]
            row = episode[step].select("observation", "action", "demonstrator_action")
            row["next"] = after.select("observation", "done", "terminated", "arrived", "collided")
            row["next", "reward"] = torch.stack(rewards).sum(0).float()
            row["episode"] = torch.tensor(number)
            rows.append(row.set("steps_to_next_obs", torch.tensor([ahead])) if n_steps > 1 else row)
    return torch.stack(rows)


def differing(found: TensorDictBase, wanted: TensorDictBase) -> set[Any]:
    """The keys whose entries are not the same bit by bit."""
    keys = set(found.keys(True, True)) ^ set(wanted.keys(True, True))
    return keys | {key for key in wanted.keys(True, True) if not _same(found[key], wanted[key])}


def _same(found: torch.Tensor, wanted: torch.Tensor) -> bool:
    return found.dtype == wanted.dtype and torch.equal(found, wanted)


@pytest.fixture(scope="module")
def fly(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[Path, list[TensorDictBase]]]:
    """Trains each run once; gives its folder and its episodes."""

    @cache
    def trained(*overrides: str) -> tuple[Path, list[TensorDictBase]]:
        run = tmp_path_factory.mktemp("runs") / "run"
        return run, flown(run, *overrides)

    return trained


@pytest.mark.parametrize(
    ("overrides", "n_steps"),
    [
        ((), 1),
        (("algo.n_steps=3", "buffer.capacity=30"), 3),
        (("algo.n_steps=3", "recurrent=gru"), 3),
    ],
    ids=["stacked", "overwritten", "memory"],
)
def test_what_is_read_is_what_was_flown(
    overrides: tuple[str, ...], n_steps: int, fly: Callable[..., tuple[Path, list[TensorDictBase]]], tmp_path: Path
) -> None:
    run, episodes = fly(*overrides)
    wanted = expected(episodes, n_steps, 0.9)
    about = export_data(run, None, tmp_path / "data")
    found = TensorDict.load_memmap(tmp_path / "data/storage", allow_pickle=False)
    kept = about["episodes"]
    if "buffer.capacity=30" in overrides:  # the newest whole episodes
        assert 0 < kept < 14 and sum(map(len, episodes[-kept - 1 :])) >= 30 >= len(found)
        wanted = wanted[-len(found) :]
        wanted["episode"] -= 14 - kept
    else:
        assert kept == 14
    different = differing(found, wanted)
    assert different <= ({("next", "reward")} if n_steps > 1 else set())
    torch.testing.assert_close(found["next", "reward"], wanted["next", "reward"])  # the order of a sum may differ

    frames, width = (3, found["observation"].shape[-1] // 3) if n_steps == 1 else (1, 0)
    begins = found["episode"].diff(prepend=torch.tensor([-1])) == 1
    assert frames == 1 or not found["observation"][begins, : 2 * width].any(), "nothing was seen before"
    assert frames == 1 or found["observation"][~begins, width : 2 * width].any(-1).all()
    assert found["action"].ne(found["demonstrator_action"]).any()

    for buffer in (uavrl.load_data(tmp_path / "data"), uavrl.load_data(run)):
        assert differing(buffer.storage[:], found) == set()
        assert differing(buffer[torch.tensor([1, 0])].exclude("index"), found[torch.tensor([1, 0])]) == set()

    told = json.loads((tmp_path / "data/data.json").read_text())
    shapes = {tuple(key.split(".")): (entry["shape"], entry["dtype"]) for key, entry in told["keys"].items()}
    assert shapes == {
        (key,) if isinstance(key, str) else key: (list(value.shape[1:]), str(value.dtype)[6:])
        for key, value in found.items(True, True)
    }
    assert not [key for key, entry in told["keys"].items() if "a quantity of the environment" in entry["meaning"]]
    outcomes = Counter(episode.outcome for episode in read_episodes(run / "episodes.csv")[-kept:])
    assert {name: count for name, count in told["outcomes"].items() if count} == outcomes
    assert told["transitions"] == len(found) and told["run"] == "run"
    assert told["policy_inputs"]["state"]["size"] == found["observation"].shape[-1]
    assert told["policy_inputs"]["action"]["unit"][0] == "m/s, forward"
    assert told["settings"]["choices"]["demonstrator"] == "vfh" and told["settings"]["env"]["num_uavs"] == 2


@pytest.fixture(scope="module")
def data(fly: Callable[..., tuple[Path, list[TensorDictBase]]]) -> Path:
    """The data set of the first of these runs."""
    run, _ = fly()
    export_data(run, None, run.parent / "my_data")
    return run.parent / "my_data"


def test_torchrl_trains_on_it_where_there_is_no_uavrl(data: Path) -> None:
    """The example of the page, in a process of its own; the storage loads it, too."""
    script = f"""
import hashlib, sys
from pathlib import Path
sys.modules.update(uavrl=None, uavrl_onboard=None)
{EXAMPLE}
from torchrl.data import LazyMemmapStorage
storage = LazyMemmapStorage(len(data))
storage.loads(Path("my_data/storage"))
assert (storage.get(range(len(data))) == data).all()
print(hashlib.sha256(data["observation"].numpy().tobytes()).hexdigest())
print(sum(losses[:5]), sum(losses[-5:]))
"""
    command = [sys.executable, "-W", "error::FutureWarning:tensordict", "-c", script]
    done = subprocess.run(command, cwd=data.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    digest, losses = done.stdout.splitlines()[-2:]
    seen = tensordict.load(data / "storage", allow_pickle=False)["observation"]
    assert digest == hashlib.sha256(seen.numpy().tobytes()).hexdigest()
    first, last = map(float, losses.split())
    assert last < 0.3 * first


def test_a_buffer_gives_batches_and_slices_and_takes_nothing(data: Path) -> None:
    buffer = uavrl.load_data(data, batch_size=7)
    batch = buffer.sample()
    assert batch["observation"].shape == (7, 237) and batch["next", "reward"].shape == (7, 1)
    before = tensordict.load(data / "storage", allow_pickle=False).clone()
    with pytest.raises(RuntimeError, match="doesn't allow writing"):
        buffer.extend(batch.zero_())
    assert differing(tensordict.load(data / "storage", allow_pickle=False), before) == set()
    sampler = SliceSampler(slice_len=3, traj_key="episode", strict_length=False)
    slices = TensorDictReplayBuffer(storage=TensorStorage(before), sampler=sampler, batch_size=300).sample()
    index = slices["index"].reshape(-1)
    together = slices["episode"].diff() == 0
    assert together.any() and (index.diff()[together] == 1).any()


def test_of_an_overwritten_buffer_whole_episodes_are_left(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    lengths = torch.randint(3, 9, (9,), generator=generator).tolist()
    written = [walk(length, 6, np.random.default_rng(length)) for length in lengths]
    checkpoint_run(tmp_path / "run", written, capacity=17)
    found = uavrl.load_data(tmp_path / "run").storage[:]
    kept = int(found["episode"].max()) + 1
    assert kept >= 2 and torch.equal(found["observation"], torch.from_numpy(np.concatenate(written[-kept:])))


def test_a_buffer_that_holds_no_whole_episode_should_have_been_larger(tmp_path: Path) -> None:
    checkpoint_run(tmp_path / "run", [walk(length, 6, np.random.default_rng(0)) for length in (5, 20)], capacity=17)
    with pytest.raises(UavrlError, match=r"found none: train with a larger buffer\.capacity"):
        uavrl.load_data(tmp_path / "run")


def copied(data: Path, to: Path) -> Path:
    """A copy that a stranger may have changed."""
    return Path(shutil.copytree(data, to))


def _pickle(folder: Path, mark: Path) -> None:
    (folder / "storage/next/other.pickle").write_bytes(pickle.dumps(Payload(mark)))


def _tensorclass(folder: Path, mark: Path) -> None:
    (folder / "storage/extra").mkdir()
    about = json.loads((folder / "storage/meta.json").read_text())
    about["extra"] = {"type": "NonTensorData"}
    (folder / "storage/meta.json").write_text(json.dumps(about))
    other = {"_type": "<class 'tensordict.tensorclass.NonTensorData'>", "shape": [], "device": "cpu"}
    (folder / "storage/extra/meta.json").write_text(json.dumps(other))


def _link(folder: Path, mark: Path) -> None:
    (folder / "storage/action.memmap").unlink()
    (folder / "storage/action.memmap").symlink_to("/etc/hostname")


@pytest.mark.parametrize("change", [_pickle, _tensorclass, _link])
def test_nothing_in_a_foreign_folder_is_executed_or_followed(change: Any, data: Path, tmp_path: Path) -> None:
    folder = copied(data, tmp_path / "data")
    change(folder, tmp_path / "ran")
    with pytest.raises(UavrlError, match=r"none of it was loaded|leads out of"):
        uavrl.load_data(folder)
    assert not (tmp_path / "ran").exists()


def test_a_damaged_or_other_data_set_is_refused(data: Path, tmp_path: Path) -> None:
    folder = copied(data, tmp_path / "data")
    about, actions = (folder / "storage" / name for name in ("meta.json", "action.memmap"))
    whole = actions.read_bytes()
    actions.write_bytes(whole[:-16])  # four numbers of float32
    with pytest.raises(UavrlError, match=rf"action\.memmap has {len(whole) - 16:,} of {len(whole):,} bytes, so it"):
        uavrl.load_data(folder)
    rows = json.loads(about.read_text())
    whole_description = json.dumps(rows)
    rows["action"]["shape"][0] -= 1
    about.write_text(json.dumps(rows))
    with pytest.raises(UavrlError, match=r"is damaged .*in all entries"):
        uavrl.load_data(folder)
    about.write_text(whole_description)
    actions.write_bytes(whole)
    uavrl.load_data(folder)
    (folder / "storage/next/meta.json").rename(folder / "storage/meta.aside")
    with pytest.raises(UavrlError, match=r"has no next/meta\.json, so it is incomplete, .*: copy or write it again"):
        uavrl.load_data(folder)
    (folder / "storage/meta.aside").rename(folder / "storage/next/meta.json")
    (folder / "storage/meta.json").unlink()
    with pytest.raises(UavrlError, match=r"is damaged .*meta\.json is missing"):
        uavrl.load_data(folder)
    (folder / "data.json").write_text('{"format": "uavrl.data", "version": 99}')
    with pytest.raises(UavrlError, match=r"data\.json does not describe a data set that this version"):
        uavrl.load_data(folder)
    with pytest.raises(UavrlError, match="Expected a run folder at"):
        uavrl.load_data(tmp_path / "none")
    with pytest.raises(UavrlError, match=r"is neither a data set \(data\.json\) nor the folder of a run"):
        uavrl.load_data(tmp_path)


def _other_type(folder: Path) -> str:
    about = json.loads((folder / "storage/meta.json").read_text())
    about["observation"]["dtype"] = "torch.int32"
    (folder / "storage/meta.json").write_text(json.dumps(about))
    return r"tells of observation as float32 \[\d+\], and it is int32 \[\d+\]"


def _without_actions(folder: Path) -> str:
    about = json.loads((folder / "storage/meta.json").read_text())
    del about["action"]
    (folder / "storage/meta.json").write_text(json.dumps(about))
    return "also describes action"


def _fewer(folder: Path) -> str:
    about = json.loads((folder / "data.json").read_text())
    (folder / "data.json").write_text(json.dumps({**about, "transitions": 5}))
    return r"tells of 5 transitions, and there are \d+"


def _nothing_described(folder: Path) -> str:
    about = json.loads((folder / "data.json").read_text())
    (folder / "data.json").write_text(json.dumps({**about, "keys": {}}))
    return "lacks action"


@pytest.mark.parametrize("change", [_other_type, _without_actions, _fewer, _nothing_described])
def test_numbers_that_are_not_those_described_are_refused(change: Any, data: Path, tmp_path: Path) -> None:
    folder = copied(data, tmp_path / "data")
    told = change(folder)
    with pytest.raises(UavrlError, match=f"is not that of its data.json, which {told}: copy all of it again"):
        uavrl.load_data(folder)


@pytest.mark.parametrize("size", [0, -1, 1.5, "a", True])
def test_a_batch_of_no_size_is_refused(size: Any, data: Path) -> None:
    with pytest.raises(UavrlError, match="batch_size must be a whole number of transitions, 1 or more, or None, got"):
        uavrl.load_data(data, batch_size=size)
