from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.helpers.folders import POSITION_STATS, ROOT, evaluation, run_folder
from uavrl.config import compose, learner_name, resolve
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report
from uavrl.reporting.runs import Run, read_runs


def only(folder: Path) -> Run:
    (run,), left_out = read_runs([folder])
    assert not left_out
    return run


def reason(folder: Path) -> str:
    runs, (left,) = read_runs([folder])
    assert not runs
    return left.reason


def test_a_run_folder(tmp_path: Path) -> None:
    run = only(run_folder(tmp_path / "one", "cat", seed=3))
    assert (run.name, run.seed, run.steps, run.finished) == ("one", 3, 30, True)
    assert [e.outcome for e in run.episodes] == ["collided", "arrived", "timed_out"]
    assert (run.choices["algo"], run.settings["algo"], run.settings["algo.gamma"]) == ("td3", "td3", 0.99)
    assert run.notes == [] and run.versions == {} and run.evaluations == []


def test_runs_are_found_below_a_folder_each_once(tmp_path: Path) -> None:
    for name in ("sweep/a", "sweep/deep/b", "c", ".hidden/d", "1/2/3/4/5/e"):
        run_folder(tmp_path / name, "a")
    (tmp_path / "sweep/a/states").mkdir()
    (tmp_path / "sweep/a/states/episodes.csv").write_text("what lies in a run is none")
    runs, left_out = read_runs([tmp_path / "sweep", tmp_path / "sweep/a", tmp_path])
    assert [run.name for run in runs] == ["a", "b", "c"] and not left_out
    run_folder(tmp_path / "d/c", "a", seed=1)
    names = [run.name for run in read_runs([tmp_path])[0]]
    assert names == [f"{tmp_path.name}/c", "d/c", "a", "b"], "runs of one name are named with their folder"


def test_a_folder_without_a_run_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder, told in (("nowhere", "There is no such folder"), ("file", "It contains no runs")):
        assert reason(tmp_path / folder) == f"{told}: pass the folder that uavrl-train printed."
    assert "exported policy" in reason(ROOT / "uavrl/policies/data/best")


@pytest.mark.parametrize(
    ("name", "content", "lacks"),
    [
        *[("config.yaml", text, None) for text in (b"", b"env: {", b"- a\n- list\n", b"\x00\xff\xfe\x80")],
        *[("episodes.csv", text, None) for text in (b"", b"\x00\xff\xfe\x80\n")],
        ("episodes.csv", b"minutes,total_steps,outcome\n0.0683,41,collided\n", "column `episode`"),
        ("episodes.csv", b"episode,total_steps,outcome\n1,41,collided\n", "column `episode_return`"),
        ("config.yaml", b"env: {name: static}\n", "key `seed`"),
        ("config.yaml", b"seed: 0\ntrainer: {episodes: 3}\n", "key `choices`"),
        ("config.yaml", b"seed: 0\ntrainer: {}\nchoices: {}\n", "key `trainer.episodes`"),
    ],
)
def test_a_file_that_is_broken_or_of_another_format_is_named(
    tmp_path: Path, name: str, content: bytes, lacks: str | None
) -> None:
    folder = run_folder(tmp_path / "run", "aca")
    (folder / name).write_bytes(content)
    broken = f"{name} cannot be read: mend it from a copy, or leave the folder out."
    other = f"{name} has no {lacks}: it was not written by this version of uavrl-train."
    assert reason(folder) == (other if lacks else broken)
    (folder / name).unlink()
    assert reason(folder) == f"{name} is missing: bring it back, or leave the folder out."


def test_rows_of_episodes_that_cannot_be_are_no_run_and_one_cut_off_does_not_count(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "aca")
    file = folder / "episodes.csv"
    text = file.read_text()
    for find, replace in (
        ("2,20,collided", "2,20,crashed"),
        ("2,20,", "2,5,"),
        ("2,20,", "7,20,"),
        ("3,30,", f"3,{10**20},"),
        ("2,20,collided,-10.0", "2,20,collided,nan"),
    ):
        assert find in text
        file.write_text(text.replace(find, replace))
        assert reason(folder).startswith("episodes.csv cannot be read"), replace
    file.write_text(text[:-20])
    assert len(only(folder).episodes) == 2


def test_a_run_without_an_episode_is_not_called_damaged(tmp_path: Path) -> None:
    said = "episodes.csv has no episode yet: let the run train on, or leave the folder out."
    assert reason(run_folder(tmp_path / "begun", "")) == said


def test_a_run_is_called_by_its_choices_whatever_its_values_are(tmp_path: Path) -> None:
    config = resolve(compose("algo=ddpg", "lifeguard=mlp", "reward=traditional", "run_dir=here"))
    folder = run_folder(tmp_path / "run", "a")
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
    run = only(folder)
    assert learner_name(run.choices) == "ddpg_lg_mlp" and run.settings["reward"] == "traditional"
    assert not [key for key in run.settings if key.endswith(("_target_", ".name")) or key.startswith("choices")]


def test_class_sizes_are_those_of_the_artifact(tmp_path: Path) -> None:
    for made in ("artifact", "pretrained"):
        (run_folder(tmp_path / made, "a") / made).mkdir()
        sizes = {"class_sizes": {"psae": {"classes": 5, "sd": 1.5}}}
        (tmp_path / made / made / "artifact.json").write_text(json.dumps(sizes))
        assert only(tmp_path / made).class_sizes == {"psae": {"number": 5, "sd": 1.5}}


def test_evaluations_are_read_without_their_episodes(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "a")
    evaluation(folder, 8, 10, position_stats=POSITION_STATS)
    evaluation(folder, 5, 10, "evaluation_valleys=100.json", valleys=[100], path_efficiency="x")
    (folder / "evaluation_bad.json").write_text("{")
    run = only(folder)
    assert [(e["file"], e["flown"], e["success"]["rate"]) for e in run.evaluations] == [
        ("evaluation.json", "static, valleys 0, 10 tasks of seed 20000", 0.8),
        ("evaluation_valleys=100.json", "static, valleys 100, 10 tasks of seed 20000", 0.5),
    ]
    assert run.evaluations[0]["success"] == pytest.approx({"rate": 0.8, "low": 0.4902, "high": 0.9433}, abs=1e-4)
    assert run.evaluations[0]["position_stats"]["altitude"]["p50"] == 3.46
    assert "flights" not in run.evaluations[0]
    assert (run.evaluations[0]["action_change"], run.evaluations[0]["yaw_reversals"]) == (None, None)
    evaluation(folder, 8, 10, action_change=[0.21, 0.05, 0, 0.4], yaw_reversals=0.06)
    measured = only(folder).evaluations[0]
    assert (measured["action_change"], measured["yaw_reversals"]) == ([0.21, 0.05, 0.0, 0.4], 0.06)
    assert run.notes == ["evaluation_bad.json cannot be read and is left out."]


@pytest.mark.parametrize(
    ("told", "among"),
    [
        ({"num_uavs": 8}, ", 8 UAVs at a time"),
        ({"num_uavs": 1, "processes": 2}, ", 1 UAV at a time in each of 2 processes"),
        ({"num_uavs": 8, "processes": 2, "planes": 0}, ""),
    ],
)
def test_evaluations_among_planes_that_move_otherwise_are_not_of_the_same_tasks(
    told: dict[str, Any], among: str, tmp_path: Path
) -> None:
    folder = run_folder(tmp_path / "run", "a")
    evaluation(folder, 8, 10, **{"planes": 3, **told})
    assert only(folder).evaluations[0]["flown"] == f"static, valleys 0, 10 tasks of seed 20000{among}"


def test_a_broken_evaluation_is_noted_and_left_out(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "a")
    damages: list[dict[str, Any]] = [
        {"episodes": 0},
        {"success": {"rate": "much"}},
        {"success": {"rate": 1.2}},
        {"collision": {"rate": float("inf")}},
        {"position_stats": {**POSITION_STATS, "height_quarters": [0.5, 0.5]}},
        {"position_stats": {**POSITION_STATS, "altitude": {"p5": 1.0, "p50": 2.0}}},
        {"action_change": [0.1, 0.2], "yaw_reversals": 0.1},
        {"action_change": [0.1, float("nan")]},
        {"action_change": 0.1},
    ]
    for damage in damages:
        evaluation(folder, 8, 10, **damage)
        run = only(folder)
        assert (run.evaluations, run.notes) == ([], ["evaluation.json cannot be read and is left out."]), damage


@pytest.mark.parametrize(
    ("name", "content", "lacks"),
    [
        ("evaluation.json", [1, 2], "key `episodes`: it was not written by this version of uavrl-evaluate"),
        (
            "evaluation.json",
            {"episodes": 3, "success": 0.5},
            "key `success.rate`: it was not written by this version of",
        ),
        ("summary.json", {"steps": 3}, "key `versions`: it was not written by this version of uavrl-train"),
        ("artifact/artifact.json", {}, "key `class_sizes`: it was not written by this version of uavrl-pretrain"),
    ],
)
def test_a_whole_file_of_another_format_is_not_called_damaged(
    tmp_path: Path, name: str, content: Any, lacks: str
) -> None:
    folder = run_folder(tmp_path / "run", "a")
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(json.dumps(content))
    (note,) = only(folder).notes
    assert note.startswith(f"{Path(name).name} has no {lacks}") and note.endswith(". It is left out.")


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


@pytest.mark.parametrize("change", [{"backward_reward": ["abr"]}, {"env__world__obstacle_scale": 10**400}])
def test_a_configuration_of_another_shape_leaves_the_others_in_the_report(tmp_path: Path, change: Any) -> None:
    run_folder(tmp_path / "odd", "ac", **change)
    run_folder(tmp_path / "whole", "ac", seed=1)
    report = make_report([tmp_path])
    assert len(report.runs) + len(report.left_out) == 2
    assert page(report)
