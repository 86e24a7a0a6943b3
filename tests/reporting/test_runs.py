from __future__ import annotations

import json
import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.reporting.folders import DOCUMENTED, ROOT, WHEREABOUTS, evaluation, run_folder
from uavrl.configs import complete, compose
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report
from uavrl.reporting.runs import Run, find_run_folders, read_runs


def only(folder: Path) -> Run:
    (run,), left_out = read_runs([folder])
    assert not left_out
    return run


def reason(folder: Path) -> str:
    runs, (left,) = read_runs([folder])
    assert not runs and left.folder == str(folder)
    return left.reason


def test_a_run_folder(tmp_path: Path) -> None:
    run = only(run_folder(tmp_path / "one", "cat", seed=3, algo__name="td3"))
    assert (run.name, run.seed, run.learner, run.planned, run.finished) == ("one", 3, "td3", 3, True)
    assert [e.outcome for e in run.episodes] == ["collided", "arrived", "timed_out"]
    assert (run.choices["algo"], run.settings["algo"], run.settings["algo.gamma"]) == ("td3", "td3", 0.99)
    assert run.notes == [] and run.versions == {} and run.evaluations == []


def test_the_runs_that_the_documentation_keeps() -> None:
    runs, left_out = read_runs(DOCUMENTED)
    assert not left_out
    assert sorted((run.learner, run.seed) for run in runs) == [
        ("td3", 0),
        ("td3", 1),
        ("td3_fork", 0),
        ("td3_lg", 0),
        ("td3_lg_mlp", 0),
        ("td3_lg_mlp", 1),
    ]
    assert all(run.finished for run in runs)


def test_runs_are_found_below_a_folder_each_once(tmp_path: Path) -> None:
    for name in ("sweep/a", "sweep/deep/b", "c"):
        run_folder(tmp_path / name, "a")
    (tmp_path / "sweep/a/states").mkdir()
    (tmp_path / "sweep/a/states/episodes.csv").write_text("what a recording of states has")
    (tmp_path / ".hidden").mkdir()
    found, left_out = find_run_folders([tmp_path / "sweep", tmp_path / "sweep/a", tmp_path])
    assert [f.relative_to(tmp_path).as_posix() for f in found] == ["sweep/a", "sweep/deep/b", "c"]
    assert not left_out


def test_runs_of_one_name_are_told_apart(tmp_path: Path) -> None:
    for name in ("x/run", "y/run"):
        run_folder(tmp_path / name, "a", seed=ord(name[0]))
    assert [run.name for run in read_runs([tmp_path])[0]] == ["x/run", "y/run"]


def test_no_such_folder_and_no_run(tmp_path: Path) -> None:
    assert "no such folder" in reason(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    assert reason(tmp_path / "file") == "It is no folder: give the one that uavrl-train printed."
    (tmp_path / "empty").mkdir()
    assert "holds no run" in reason(tmp_path / "empty")


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("config.yaml", None, "config.yaml is missing"),
        ("episodes.csv", None, "episodes.csv is missing"),
        ("config.yaml", b"", "config.yaml is damaged"),
        ("config.yaml", b"env: {", "config.yaml is damaged"),
        ("config.yaml", b"- a\n- list\n", "config.yaml is damaged"),
        ("config.yaml", b"env: {name: static}\n", "perception is not in it"),
        ("config.yaml", b"\x00\xff\xfe\x80", "config.yaml is damaged"),
        ("episodes.csv", b"", "episodes.csv"),
        ("episodes.csv", b"\x00\xff\xfe\x80\n", "no text"),
        ("episodes.csv", b"some,other,table\n1,2,3\n", "something else"),
    ],
)
def test_a_missing_or_damaged_file_is_told(tmp_path: Path, name: str, content: bytes | None, expected: str) -> None:
    folder = run_folder(tmp_path / "run", "aca")
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    sentence = reason(folder)
    assert expected in sentence
    assert "leave the folder out" in sentence


@pytest.mark.parametrize(
    ("find", "replace"),
    [
        ("2,20,collided", "2,20,crashed"),
        ("2,20,", "2,5,"),
        ("2,20,", "7,20,"),
        ("2,20,", "2,x,"),
        ("3,30,", f"3,{10**20},"),
    ],
)
def test_a_row_that_cannot_be_is_told(tmp_path: Path, find: str, replace: str) -> None:
    folder = run_folder(tmp_path / "run", "aca")
    text = (folder / "episodes.csv").read_text()
    (folder / "episodes.csv").write_text(text.replace(find, replace))
    assert "damaged" in reason(folder)


def test_an_exported_policy_is_told_from_a_run() -> None:
    assert "exported policy" in reason(ROOT / "uavrl/policies/static")


@pytest.mark.parametrize("value", [["abr"], {"name": ["abr"]}])
def test_a_configuration_of_another_shape_leaves_the_others_in_the_report(tmp_path: Path, value: object) -> None:
    run_folder(tmp_path / "odd", "ac", backward_reward=value)
    run_folder(tmp_path / "huge", "ac", env__world__obstacle_scale=10**400)
    run_folder(tmp_path / "whole", "ac", seed=1)
    report = make_report([tmp_path])
    assert "whole" in [run["name"] for run in report.runs]
    assert len(report.runs) + len(report.left_out) == 3
    assert page(report)


def test_returns_that_are_no_numbers_are_noted(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "aca")
    text = (folder / "episodes.csv").read_text()
    (folder / "episodes.csv").write_text(text.replace("2,20,collided,-10.0", "2,20,collided,nan"))
    assert only(folder).notes == ["1 of its returns in episodes.csv are no numbers, and so are the means over them."]


@pytest.mark.parametrize("made", ["artifact", "pretrained"])
def test_class_sizes_are_those_of_the_artifact(tmp_path: Path, made: str) -> None:
    folder = run_folder(tmp_path / "run", "a")
    (folder / made).mkdir()
    (folder / made / "artifact.json").write_text(json.dumps({"class_sizes": {"psae": {"classes": 5, "sd": 1.5}}}))
    assert only(folder).class_sizes == {"psae": {"classes": 5, "sd": 1.5}}


def test_a_row_cut_off_does_not_count(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "aca")
    file = folder / "episodes.csv"
    file.write_bytes(file.read_bytes()[:-20])
    run = only(folder)
    assert len(run.episodes) == 2 and not run.finished
    assert run.notes == ["The last row of episodes.csv is cut off and does not count."]


def test_a_run_before_its_first_episode(tmp_path: Path) -> None:
    assert "no whole episode" in reason(run_folder(tmp_path / "run", ""))


def test_a_configuration_of_another_version_is_compared_as_it_stands(tmp_path: Path) -> None:
    run = only(run_folder(tmp_path / "run", "a", env__altitude_of_the_moon=3))
    assert run.settings["env.altitude_of_the_moon"] == 3


def test_a_run_is_called_by_its_choices_whatever_its_values_are(tmp_path: Path) -> None:
    config = complete(compose("algo=ddpg", "lifeguard=mlp", "reward=traditional", "run_dir=here"))
    folder = run_folder(tmp_path / "run", "a")
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
    run = only(folder)
    assert run.learner == "ddpg_lg_mlp" and run.settings["reward"] == "traditional"
    assert not [key for key in run.settings if key.endswith(("_target_", ".name")) or key.startswith("choices")]


def test_evaluations_are_read_without_their_flights(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "a")
    evaluation(folder, 8, 10)
    evaluation(folder, 5, 10, "evaluation_valleys=100.json", valleys=[100])
    (folder / "evaluation_bad.json").write_text("{")
    (folder / "evaluation_other.json").write_text(json.dumps({"success": 1}))
    run = only(folder)
    assert [(e["file"], e["success"]["rate"]) for e in run.evaluations] == [
        ("evaluation.json", 0.8),
        ("evaluation_valleys=100.json", 0.5),
    ]
    assert "flights" not in run.evaluations[0]
    assert run.notes == [
        "evaluation_bad.json is damaged and was not read.",
        "evaluation_other.json is not what uavrl-evaluate writes and was not read.",
    ]


@pytest.mark.parametrize(
    ("find", "replace"),
    [
        ('"episodes": 10', '"episodes": Infinity'),
        ('"rate": 0.8', '"rate": 1e999'),
        ('"rate": 0.8', '"rate": "much"'),
        ('"training_steps": 40', f'"training_steps": {10**400}'),
    ],
)
def test_a_damaged_evaluation_is_noted_and_left_out(tmp_path: Path, find: str, replace: str) -> None:
    path = evaluation(run_folder(tmp_path / "run", "a"), 8, 10)
    text = path.read_text()
    assert text.count(find) == 1
    path.write_text(text.replace(find, replace))
    run = only(tmp_path / "run")
    assert run.evaluations == []
    assert run.notes == ["evaluation.json is not what uavrl-evaluate writes and was not read."]


@pytest.mark.parametrize(
    "damage",
    [
        {"altitude": {"p5": 1.0, "p50": 2.0}},
        {"height_quarters": [0.5, 0.5]},
        {"wall_distance": {"p5": 1.0, "p50": float("nan"), "p95": 3.0}},
        {"altitude_histogram": {"low": 2.0, "step": 0.25, "counts": []}},
        {"altitude_histogram": "high"},
    ],
)
def test_an_evaluation_with_damaged_whereabouts_is_noted_and_left_out(tmp_path: Path, damage: dict[str, Any]) -> None:
    folder = run_folder(tmp_path / "run", "a")
    evaluation(folder, 8, 10, whereabouts={**WHEREABOUTS, **damage})
    evaluation(folder, 5, 10, "evaluation_2.json", whereabouts=WHEREABOUTS)
    run = only(folder)
    assert [e["file"] for e in run.evaluations] == ["evaluation_2.json"]
    assert run.notes == ["evaluation.json is not what uavrl-evaluate writes and was not read."]


def test_numbers_of_an_evaluation_that_are_texts_are_read_as_numbers(tmp_path: Path) -> None:
    path = evaluation(run_folder(tmp_path / "run", "a"), 8, 10, file="another", group="none")
    text = path.read_text()
    path.write_text(text.replace('"rate": 0.8', '"rate": "0.8"').replace('"episodes": 10', '"episodes": "10"'))
    (read,) = only(tmp_path / "run").evaluations
    assert (read["success"]["rate"], read["episodes"], read["file"]) == (0.8, 10, "evaluation.json")
    assert "80.0 %" in page(make_report([tmp_path], window=1))


def test_a_folder_that_cannot_be_read_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_folder(tmp_path / "run", "a")
    (tmp_path / "secret").mkdir()

    def refusing(ask: Callable[[Path], bool]) -> Callable[[Path], bool]:
        def asked(path: Path) -> bool:  # what a folder without permissions does to anyone but root
            if path.parent.name == "secret":
                raise PermissionError(13, "Permission denied", str(path))
            return ask(path)

        return asked

    monkeypatch.setattr(Path, "exists", refusing(Path.exists))
    monkeypatch.setattr(Path, "is_dir", refusing(Path.is_dir))
    told = "It cannot be read (Permission denied): check its permissions."
    found, left_out = find_run_folders([tmp_path, tmp_path / "secret", tmp_path / "secret/below"])
    assert found == [tmp_path / "run"]
    assert [(left.folder, left.reason) for left in left_out] == [
        (str(tmp_path / "secret"), told),
        (str(tmp_path / "secret/below"), told),
    ]


def test_the_commit_comes_from_the_summary_or_from_the_newest_checkpoint(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "a")
    (folder / "checkpoints").mkdir()
    for steps, commit in ((10, "old"), (20, "new")):
        with zipfile.ZipFile(folder / f"checkpoints/checkpoint-{steps:012}.torchrl", "w") as archive:
            archive.writestr("manifest.json", json.dumps({"metadata": {"uavrl": "0.1.0", "commit": commit}}))
    (folder / "checkpoints/checkpoint-000000000030.torchrl").write_bytes(b"half written")
    assert only(folder).versions == {"uavrl": "0.1.0", "commit": "new"}
    ended = {"episodes": 1, "versions": {"uavrl": "0.1.0", "commit": None}}
    (folder / "summary.json").write_text(json.dumps(ended))
    assert only(folder).versions == {"uavrl": "0.1.0"}
    (folder / "summary.json").write_text(json.dumps(ended | {"episodes": 0}))
    assert only(folder).versions == {"uavrl": "0.1.0", "commit": "new"}, "it has gone on since"
    (folder / "summary.json").write_text("{half")
    assert only(folder).notes == ["summary.json is damaged and was not read."]


def test_no_damage_raises(tmp_path: Path) -> None:
    draw = random.Random(0)
    folder = run_folder(tmp_path / "run", "acat" * 3)
    evaluation(folder, 8, 10)
    whole = {path: path.read_bytes() for path in folder.iterdir()}
    for _ in range(60):
        path = draw.choice(sorted(whole))
        content = bytearray(whole[path])
        for _ in range(draw.randint(1, 3)):
            content[draw.randrange(len(content))] = draw.randrange(256)
        path.write_bytes(content[: draw.randint(0, len(content))])
        runs, left_out = read_runs([folder])
        assert len(runs) + len(left_out) == 1
        path.write_bytes(whole[path])
