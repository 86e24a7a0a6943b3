"""A policy on its own flies as its run does, and damaged ones are refused in a sentence."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from omegaconf import OmegaConf

from tests.helpers.commands import SMALL_EVALUATION, content, in_process
from tests.helpers.states import checkpoint_run
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import export as export_command
from uavrl.cli import replay as replay_command
from uavrl.config import validate
from uavrl.evaluation.policies import PACKAGED, packaged_policies
from uavrl.runs.config import load_config


@pytest.fixture
def policy(run_dir: Path, tmp_path: Path) -> Path:
    assert in_process(export_command.main, f"run={run_dir}", f"output={tmp_path / 'policy'}") == 0
    return tmp_path / "policy"


def test_it_flies_as_its_run_does(run_dir: Path, policy: Path, tmp_path: Path) -> None:
    results = []
    for folder in (run_dir, policy):
        output = tmp_path / f"{folder.name}.json"
        arguments = [f"run={folder}", f"output={output}", *SMALL_EVALUATION]
        assert in_process(evaluate_command.main, *arguments) == 0
        results.append(json.loads(output.read_text()))
    assert results[0]["flights"] == results[1]["flights"]
    assert results[0]["training_steps"] == results[1]["training_steps"] > 0
    assert sum(len(file) for file in content(policy).values()) < 50_000
    assert str(run_dir) not in (policy / "config.yaml").read_text()
    weights = {"policy.json", "policy.onnx", "policy.safetensors"}
    assert set(content(policy)) == {"README.md", "config.yaml", "contract.json", *weights}
    about, terms = (json.loads((policy / file).read_text()) for file in ("policy.json", "contract.json"))
    assert terms["weights_sha256"] == about["weights_sha256"] and terms["state"]["size"] == 105
    assert about["versions"] == json.loads((run_dir / "summary.json").read_text())["versions"]
    assert OmegaConf.load(policy / "config.yaml").algo == OmegaConf.load(run_dir / "config.yaml").algo


def test_it_can_be_replayed(policy: Path) -> None:
    assert in_process(replay_command.main, f"run={policy}", "points=10", "progress=false") == 0
    assert "policy" in (policy / "replay.html").read_text()


def test_a_packaged_policy_and_one_on_its_own_can_be_exported(policy: Path, tmp_path: Path) -> None:
    """They are read and written again: the same weights of the same run."""
    for chosen, source in (("policy=best", PACKAGED / "best"), (f"run={policy}", policy)):
        output = tmp_path / source.name / "again"
        assert in_process(export_command.main, chosen, f"output={output}") == 0
        assert json.loads((output / "policy.json").read_text()) == json.loads((source / "policy.json").read_text())
        assert (output / "policy.safetensors").read_bytes() == (source / "policy.safetensors").read_bytes()
        settings = [validate(load_config(folder / "config.yaml")) for folder in (output, source)]
        assert settings[0].algo == settings[1].algo and settings[0].perception == settings[1].perception


def test_an_unknown_run_and_a_taken_folder_are_refused(
    run_dir: Path, policy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = content(policy)
    new = f"output={tmp_path / 'new'}"
    for arguments, said in [
        ([f"run={tmp_path / 'nothing'}", new], "Expected a run folder"),
        (
            [f"run={run_dir}", f"output={policy}"],
            "already contains a policy or a run: choose another with output=FOLDER",
        ),
        ([f"run={run_dir}", f"output={run_dir}"], "already contains a policy or a run"),
        ([f"run={run_dir}", new, "checkpoint=none.zip"], "Expected a checkpoint"),
        ([f"run={run_dir}", "policy=best", new], "Give either run=RUN_FOLDER or policy=NAME, and not both"),
        (
            ["policy=bst", new],
            f"policy must be one of {', '.join(packaged_policies())}, got 'bst': did you mean best?",
        ),
        (["policy=straight", new], "got 'straight': to export your own give run=RUN_FOLDER"),
        ([f"run={run_dir}"], "output must be a folder to write the policy to, and none is given: add output=my_policy"),
        (["policy=best"], "output must be a folder to write the policy to, and none is given: add output=best."),
        (
            [f"data={tmp_path / 'new'}", "policy=best"],
            "data= writes the data set of a run, and none is given: add run=RUN",
        ),
        ([f"run={run_dir}", f"data={policy}"], "already exists and is not an empty folder: choose another with data="),
        ([f"run={policy}", f"data={tmp_path / 'new'}"], "Expected a checkpoint in"),
        ([f"run={run_dir}", new, "chekpoint=1"], "There is no key 'chekpoint': did you mean checkpoint?"),
    ]:
        assert in_process(export_command.main, *arguments) == 1
        assert said in capsys.readouterr().err
    assert content(policy) == before
    assert not (tmp_path / "new").exists()


def test_the_data_set_of_a_run(run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "some/data"
    both = [f"run={run_dir}", f"data={data}", f"output={tmp_path / 'both'}"]
    assert in_process(export_command.main, *both) == 0
    about = json.loads((data / "data.json").read_text())
    assert about["episodes"] == 4 and about["transitions"] > 4
    said = f"Exported {about['transitions']} transitions of 4 episodes to {data}. TorchRL reads {data / 'storage'}; "
    assert said in capsys.readouterr().out
    assert (tmp_path / "both/policy.json").is_file()
    assert str(run_dir) not in (data / "data.json").read_text()


def test_without_episodes_and_without_room_there_is_no_data_set(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint_run(tmp_path / "empty", [])
    new = f"data={tmp_path / 'new'}"
    assert in_process(export_command.main, f"run={tmp_path / 'empty'}", new) == 1
    assert "Expected whole episodes in the replay buffer of" in capsys.readouterr().err
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1000))
    assert in_process(export_command.main, f"run={run_dir}", new) == 1
    begun, said = capsys.readouterr().err.splitlines()
    assert begun == f"Loading {run_dir} ..."
    assert "MB are needed and 0.0 MB are left" in said and str(tmp_path / "new") in said
    assert not (tmp_path / "new").exists()


def _flip_a_bit(folder: Path) -> None:
    content = bytearray((folder / "policy.safetensors").read_bytes())
    content[-1] ^= 1
    (folder / "policy.safetensors").write_bytes(content)


def _cut_off(folder: Path) -> None:
    (folder / "policy.json").write_text((folder / "policy.json").read_text()[:40])


def _of_another_shape(folder: Path) -> None:
    config = OmegaConf.load(folder / "config.yaml")
    config.algo.actor.hidden = [9]
    OmegaConf.save(config, folder / "config.yaml")


def _of_the_future(folder: Path) -> None:
    about = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps({**about, "version": 99}))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (_flip_a_bit, "policy.safetensors is damaged"),
        (_cut_off, "is not of uavrl.policy 1"),
        (_of_another_shape, "are of another policy than its config.yaml describes"),
        (_of_the_future, "is not of uavrl.policy 1, which this version of uavrl reads"),
    ],
)
def test_a_damaged_policy_is_refused(
    policy: Path, damage: Callable[[Path], None], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(policy)
    assert in_process(evaluate_command.main, f"run={policy}", *SMALL_EVALUATION) == 1
    assert said in capsys.readouterr().err
