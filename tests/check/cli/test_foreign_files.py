"""What somebody else made runs nothing, whichever command is given it; runs/test_trust.py has every place and form."""

from __future__ import annotations

import hashlib
import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.commands import SMALL_EVALUATION, TINY, content, in_process, newest
from tests.helpers.finished import finished_run
from tests.helpers.foreign import (
    COMPONENTS,
    EVERYTHING,
    FOREIGN_CONFIGS,
    PLACES,
    Payload,
    plant,
    rewrite,
)
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import export as export_command
from uavrl.cli import pretrain as pretrain_command
from uavrl.cli import replay as replay_command
from uavrl.cli import train as train_command
from uavrl.evaluation import recording
from uavrl.models.psae import packaged_artifact
from uavrl.runs.trust import check_archive


def commands(run_dir: Path, tmp_path: Path) -> list[tuple[Callable[[], None], list[str]]]:
    """Every command that reads checkpoints, told to write beside the run folder."""
    replayed = [f"run={run_dir}", f"output={tmp_path / 'r.html'}", "points=10", "progress=false"]
    return [
        (evaluate_command.main, [f"run={run_dir}", f"output={tmp_path / 'e.json'}", *SMALL_EVALUATION]),
        (replay_command.main, replayed),
        (export_command.main, [f"run={run_dir}", f"output={tmp_path / 'policy'}"]),
        (train_command.main, [f"resume={run_dir}", "trainer.episodes=5"]),
        (pretrain_command.main, [f"run={run_dir}", f"output={tmp_path / 'artifact'}", "progress=false"]),
    ]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finished_run(tmp_path_factory.mktemp("runs") / "run", *TINY, *EVERYTHING)


@pytest.fixture
def policy(finished: Path, tmp_path: Path) -> Path:
    assert in_process(export_command.main, f"run={finished}", f"output={tmp_path / 'given'}") == 0
    return tmp_path / "given"


def test_the_checkpoint_of_the_fixture_is_read_by_every_command(run_dir: Path, tmp_path: Path) -> None:
    manifest = check_archive(newest(run_dir))
    assert set(manifest["components"]) == {*COMPONENTS, "replay_data"}
    for main, arguments in commands(run_dir, tmp_path)[:4]:
        assert in_process(main, *arguments) == 0


@pytest.mark.parametrize(("folder", "command"), [(PLACES[-1], 3), *((PLACES[0], i) for i in range(5))])
def test_a_pickle_in_a_checkpoint_is_refused_by_every_command(
    folder: str, command: int, run_dir: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    mark = tmp_path / "ran"
    rewrite(newest(run_dir), plant(folder, mark))
    before = content(tmp_path)
    main, arguments = commands(run_dir, tmp_path)[command]
    sentence = refused(main, *arguments)
    assert not mark.exists(), f"{main.__module__} ran what {folder} held"
    assert f"{folder}/other.pickle, which uavrl does not write: none of it was loaded" in sentence
    assert content(tmp_path) == before


# ---------------------------------------------------------------------- a policy on its own


def test_pickles_in_a_policy_folder_are_refused(policy: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    torch.save({"weights": Payload(tmp_path / "ran")}, policy / "policy.safetensors")
    about = json.loads((policy / "policy.json").read_text())
    about["weights_sha256"] = hashlib.sha256((policy / "policy.safetensors").read_bytes()).hexdigest()
    (policy / "policy.json").write_text(json.dumps(about))
    before = content(tmp_path)
    for main, arguments in commands(policy, tmp_path)[:2]:
        assert f"{policy / 'policy.safetensors'} is damaged" in refused(main, *arguments)
    assert content(tmp_path) == before


def test_a_pickle_beside_a_policy_is_not_opened(policy: Path, tmp_path: Path) -> None:
    (policy / "other.pickle").write_bytes(pickle.dumps(Payload(tmp_path / "ran")))
    (policy / "policy.pt").write_bytes(pickle.dumps(Payload(tmp_path / "ran")))
    for main, arguments in commands(policy, tmp_path)[:2]:
        assert in_process(main, *arguments) == 0
    assert not (tmp_path / "ran").exists()


# ---------------------------------------------------------------------- a configuration


@pytest.mark.parametrize(("line", "said"), FOREIGN_CONFIGS.values(), ids=FOREIGN_CONFIGS)
def test_a_configuration_runs_nothing_and_tells_nothing(
    line: str,
    said: str,
    run_dir: Path,
    policy: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refused: Callable[..., str],
) -> None:
    monkeypatch.setenv("A_SECRET", "the secret")
    monkeypatch.chdir(tmp_path)
    for folder in (run_dir, policy):
        text = (folder / "config.yaml").read_text()
        kept = [each for each in text.splitlines() if each.partition(":")[0] != line.partition(":")[0]]
        (folder / "config.yaml").write_text("\n".join([*kept, line]) + "\n")
    before = content(tmp_path)
    every = [*commands(run_dir, tmp_path)[:4], *commands(policy, tmp_path)[:2]]
    for main, arguments in every if "run_dir: ${" in line else every[::2]:
        sentence = refused(main, *arguments)
        assert said in sentence and "the secret" not in sentence
    assert content(tmp_path) == before


# ---------------------------------------------------------------------- an artifact, and recorded flights


def with_artifact(artifact: Path, run_dir: Path) -> list[str]:
    chosen = ["backward_reward=abr_plus", f"backward_reward.artifact={artifact}"]
    return [*TINY, *chosen, "perception.frames=3", f"run_dir={run_dir}"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("pickle", "{artifact}/artifact.safetensors is damaged"),
        ("sizes", "its sizes are not those of its weights"),  # before what no memory holds is made
        ("perception", "The artifact {artifact} is damaged (its perception is no mapping)"),
    ],
)
def test_a_damaged_artifact_is_refused(change: str, said: str, tmp_path: Path, refused: Callable[..., str]) -> None:
    artifact = Path(shutil.copytree(packaged_artifact(), tmp_path / "artifact"))
    about = json.loads((artifact / "artifact.json").read_text())
    if change == "pickle":
        torch.save({"weights": Payload(tmp_path / "ran")}, artifact / "artifact.safetensors")
        about["weights_sha256"] = hashlib.sha256((artifact / "artifact.safetensors").read_bytes()).hexdigest()
    about |= {"sizes": {**about["sizes"], "k": 10**10}} if change == "sizes" else {}
    about |= {"perception": []} if change == "perception" else {}
    (artifact / "artifact.json").write_text(json.dumps(about))
    sentence = refused(train_command.main, *with_artifact(artifact, tmp_path / "run"))
    assert said.format(artifact=artifact) in sentence
    assert not (tmp_path / "ran").exists()


def test_a_run_takes_nothing_from_an_artifacts_folder_but_the_artifact(tmp_path: Path) -> None:
    artifact = Path(shutil.copytree(packaged_artifact(), tmp_path / "artifact"))
    (tmp_path / "private").write_text("the secret")
    (artifact / "more").symlink_to(tmp_path / "private")
    (artifact / "other.pickle").write_bytes(pickle.dumps(Payload(tmp_path / "ran")))
    assert in_process(train_command.main, *with_artifact(artifact, tmp_path / "run")) == 0
    assert {path.name for path in (tmp_path / "run/artifact").iterdir()} == {"artifact.json", "artifact.safetensors"}
    assert not (tmp_path / "ran").exists()


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    path = folder / "flights.npz"
    arguments = ["policy=straight", "env.max_steps=5", f"data={path}", "points=10", "progress=false"]
    assert in_process(replay_command.main, *arguments, f"output={folder / 'r.html'}") == 0
    return path


@pytest.mark.parametrize(
    ("name", "value"), [("outcome", "\x1b[2J"), ("outcome", ["arrived"]), ("flown", "1"), ("steps", {})]
)
def test_flights_whose_summary_is_none_are_refused(
    name: str, value: Any, flown: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    with np.load(flown) as file:
        arrays = dict(file)
    about = json.loads(str(arrays.pop("about")))
    about["items"]["flight0"]["summary"][name] = value
    np.savez(tmp_path / "f.npz", about=np.array(json.dumps(about)), **arrays)
    assert "contains no episodes" in refused(
        replay_command.main, f"flight={tmp_path / 'f.npz'}", f"output={tmp_path / 'r.html'}"
    )


def test_flights_that_unpack_to_more_than_a_memory_holds_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setattr(recording, "MOST_BYTES", 1_000_000)
    np.savez_compressed(tmp_path / "f.npz", about=np.array("{}"), zeros=np.zeros(200_000))
    assert (tmp_path / "f.npz").stat().st_size < 5_000
    assert "contains no episodes" in refused(replay_command.main, f"flight={tmp_path / 'f.npz'}")


# ---------------------------------------------------------------------- links


@pytest.mark.parametrize("name", ["episodes.csv", "logs", ".lock", "checkpoints", "logs/run/scalars/return.csv"])
def test_a_run_folder_that_leads_elsewhere_is_not_written_to(
    name: str, run_dir: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    if (run_dir / name).is_dir():
        shutil.rmtree(run_dir / name)
    target = tmp_path / "mine"
    shutil.copy(run_dir / "episodes.csv", target)
    (run_dir / name).unlink(missing_ok=True)
    (run_dir / name).symlink_to(target)
    before = target.read_bytes()
    sentence = refused(train_command.main, f"resume={run_dir}", "trainer.episodes=5")
    assert f"{run_dir / name} is a link that leads out of {run_dir}" in sentence
    assert target.read_bytes() == before


def test_results_are_not_written_through_a_link(policy: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    for name in ("evaluation_episodes=2.json.partial", "evaluation_episodes=2.json"):
        (policy / name).symlink_to(tmp_path / "mine")
    assert in_process(evaluate_command.main, f"run={policy}", *SMALL_EVALUATION) == 0
    assert (tmp_path / "mine").read_text() == "mine"
    assert json.loads((policy / "evaluation_episodes=2.json").read_text())["episodes"] == 2
