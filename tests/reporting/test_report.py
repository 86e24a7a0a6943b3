from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.folders import POSITION_STATS, episodes, evaluation, run_folder
from uavrl.errors import UavrlError
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report
from uavrl.runs.episodes import Episode


def test_the_numbers_of_two_seeds_by_hand(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "cccaaa", seed=0)
    run_folder(tmp_path / "b", "ccccac", seed=1)
    report = make_report([tmp_path], window=4, threshold=0.75)
    first, second = report.runs
    assert first["last"]["episodes"] == 4
    assert [first["last"][name]["rate"] for name in ("success", "collision", "time_out")] == [0.75, 0.25, 0.0]
    assert first["last"]["mean_return"] == (3 * 100 - 10) / 4
    assert (first["steps_to_threshold"], second["steps_to_threshold"]) == (60, None)
    (group,) = report.groups
    assert group["success_by_seed"] == [0.75, 0.25] and group["mean_success"] == 0.5
    # 4 of 8: z² = 3.841459, half width z √(1/32 + z²/256) / (1 + z²/8)
    assert group["last"]["success"] == pytest.approx({"rate": 0.5, "low": 0.215212, "high": 0.784788}, abs=1e-5)
    assert group["steps_to_threshold"] == [60, None]
    assert group["notes"] == [] and report.warnings() == []


def test_the_best_group_comes_first(tmp_path: Path) -> None:
    for name, outcomes, choices in (
        ("a", "cca", {}),
        ("b", "aaa", {"reward": "traditional"}),
        ("c", "caa", {"fork": "on"}),
    ):
        run_folder(tmp_path / name, outcomes, choices)
    report = make_report([tmp_path], window=3)
    assert [group["label"] for group in report.groups] == ["TD3, TR", "TD3-FORK, prize", "TD3, prize"]
    assert [run["name"] for run in report.runs] == ["b", "c", "a"]
    assert report.settings["reward"] == ["traditional", "navigation_prize", "navigation_prize"]


def test_what_to_know_stands_at_the_group_and_at_the_run(tmp_path: Path) -> None:
    run_folder(tmp_path / "one", "ca", {"fork": "on"}, trainer__episodes=7)
    for seed, commit in ((0, "a" * 40), (1, "b" * 40)):
        folder = run_folder(tmp_path / f"two{seed}", "caca"[: 3 + seed], seed=seed)
        (folder / "summary.json").write_text(
            json.dumps({"versions": {"uavrl": "0.1.0", "commit": commit, "torch": None}})
        )
    report = make_report([tmp_path], window=2)
    notes = {group["label"]: group["notes"] for group in report.groups}
    assert notes == {
        "TD3-FORK, prize": ["One seed: the spread between seeds is unknown."],
        "TD3, prize": ["Its seeds have 3 to 4 episodes.", "Its runs were made by different states of the code."],
    }
    assert report.warnings() == ["one: Unfinished: 2 of 7 episodes."]
    limits = {"steps": {"trainer__steps": 11}, "good": {"trainer__until_success": 0.5}}
    for name, limit in limits.items():  # episodes take ten steps
        run_folder(tmp_path / name / "ended", "ca", trainer__episodes=7, **limit)
    assert make_report([tmp_path / "good"], window=2).warnings() == ["ended: Unfinished: 2 of 7 episodes."]
    summary = {"versions": {}, "episodes": 2}  # which a run writes when it ends
    (tmp_path / "good" / "ended" / "summary.json").write_text(json.dumps(summary))
    run_folder(tmp_path / "steps" / "begun", "ca", seed=1, trainer__episodes=7, trainer__steps=21)
    assert make_report([tmp_path / "good"], window=2).warnings() == []
    assert make_report([tmp_path / "steps"], window=2).warnings() == ["begun: Unfinished: 2 of 7 episodes."]
    assert {run["name"]: run["versions"] for run in report.runs}["two0"] == {"uavrl": "0.1.0", "commit": "a" * 40}


def test_evaluations_are_put_together_by_their_tasks(tmp_path: Path) -> None:
    for seed, arrived, other in ((0, 8, 6), (1, 10, 4)):
        folder = run_folder(tmp_path / f"run{seed}", "ca", seed=seed)
        evaluation(folder, arrived, 10)
        evaluation(folder, 1, 10, "evaluation_checkpoint=early.json", training_steps=20)
        evaluation(folder, other, 10, "evaluation_valleys=100.json", valleys=[100])
        evaluation(folder, 0, 10, "evaluation_policy=straight.json", policy="straight")
    evaluation(run_folder(tmp_path / "fork", "ca", {"fork": "on"}), 10, 10)
    evaluation(tmp_path / "run0", 5, 10, "evaluation_wind.json", overrides=["seed=3", "env.max_steps=9"], seed=3)
    first, second, third = make_report([tmp_path], window=2).evaluations
    assert first["flown"] == "static, valleys 0, 10 tasks of seed 20000" and len(first["files"]) == 7
    assert [
        (r["group"], r["seeds"], r["tasks"], r["success"]["rate"], r["success_by_seed"]) for r in first["groups"]
    ] == [
        ("TD3-FORK, prize", [0], 10, 1.0, [1.0]),
        ("TD3, prize", [0, 1], 20, 0.9, [0.8, 1.0]),
    ]
    assert second["flown"] == "static, valleys 100, 10 tasks of seed 20000"
    assert third["flown"] == "static, valleys 0, 10 tasks of seed 3, env.max_steps=9"


def test_groups_are_compared_with_the_row_of_the_thesis_that_they_repeat(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "ca", {"reward": "traditional"})
    run_folder(tmp_path / "b", "aa", {"backward_reward": "abr_plus", "lifeguard": "mlp"})
    run_folder(tmp_path / "c", "ca")
    report = make_report([tmp_path], window=2)
    rows = {(r["learner"], r["reward"]): r["ours"] for r in report.thesis["rates"]}
    (traditional,), (plus,) = rows["td3", "TR"], rows["td3_lg", "ABR⁺"]
    assert traditional["last"]["success"]["rate"] == 0.5 and traditional["unlike"] == ["2 episodes, not 5,000"]
    assert plus["unlike"] == [
        "LifeGuard is an MLP, not linear",
        "reward=navigation_prize, not navigation (Eq. 3.6)",
        "2 episodes, not 5,000",
    ]
    assert sum(map(len, rows.values())) == 2
    (steps,) = [r["ours"] for r in report.thesis["steps_to"] if r["learner"] == "td3_lg"]
    assert steps[0]["steps_to"] == [20]
    assert report.thesis["without_row"] == {
        "TD3, prize": "The thesis has no row with reward=navigation_prize, backward_reward=none and td3 in static."
    }


def test_settings_that_differ(tmp_path: Path) -> None:
    same = {"algo__gamma": 0.9, "algo__newer": 1}  # a key that the other run does not have
    run_folder(tmp_path / "a", "a", seed=0, trainer__execution="compiled", **same)
    run_folder(tmp_path / "b", "a", seed=1, trainer__execution="captured", **same)
    run_folder(tmp_path / "c", "a", run_dir="elsewhere")
    assert make_report([tmp_path], window=1).settings == {
        "algo.gamma": ["0.9", "0.99"],
        "algo.newer": ["1", "–"],
        "trainer.execution": ["compiled / captured", "auto"],
    }


def test_what_is_wrong_is_named_and_the_rest_reported(tmp_path: Path) -> None:
    run_folder(tmp_path / "good", "ca", trainer__episodes=7)
    (run_folder(tmp_path / "bad", "ca", seed=1) / "config.yaml").unlink()
    report = make_report([tmp_path, tmp_path / "nowhere"], window=5)
    assert [run["name"] for run in report.runs] == ["good"]
    told = [
        "nowhere is left out",
        "bad is left out. config.yaml is missing",
        "good: Unfinished: 2 of 7",
        "It has 2 episodes, fewer than ",
    ]
    for warning, fact in zip(report.warnings(), told, strict=True):
        assert fact in warning


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, r"There is nothing to report\. .*contains no runs"),
        ({"window": 0}, "must be"),
        ({"threshold": 0.0}, "must be"),
        ({"threshold": 1.5}, "must be"),
        ({"threshold": float("nan")}, "must be"),
    ],
)
def test_nothing_to_report_and_numbers_out_of_range(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UavrlError, match=message):
        make_report([tmp_path], **settings)


def test_the_return_is_split_by_its_terms_where_all_episodes_name_them(tmp_path: Path) -> None:
    older, newer = run_folder(tmp_path / "older", "ca"), run_folder(tmp_path / "newer", "ca", seed=1)
    rows = [replace(each, terms={"progress": 2.0 * each.episode, "arrival": 0.0}) for each in episodes("ca")]
    lines = [",".join(map(str, line)) for line in (Episode.header(rows[0].terms), *(r.row(r.terms) for r in rows))]
    (newer / "episodes.csv").write_text("\n".join(lines) + "\n")
    report = make_report([newer])
    assert report.groups[0]["last"]["return_terms"] == {"progress": 3.0, "arrival": 0.0}
    shown = page(report)
    assert "Terms of the return" in shown and re.search(r"<th[^>]*>progress</th>", shown)
    both = make_report([older, newer])
    assert both.groups[0]["last"]["return_terms"] == {}
    assert "Terms of the return" not in page(both)


def test_json_gives_back_the_facts_and_names_no_place_of_this_machine(tmp_path: Path) -> None:
    artifact = {"artifact": str(tmp_path / "deep/artifact")}
    folder = run_folder(tmp_path / "a", "ca", run_dir=str(tmp_path / "a"), backward_reward=artifact)
    run_folder(tmp_path / "empty", "")
    evaluation(folder, 8, 10, path_efficiency=float("nan"), position_stats=POSITION_STATS)
    report = make_report([tmp_path, tmp_path / "nowhere"], window=2)
    facts = json.loads(report.to_json())
    assert facts == report.facts() and facts["format"] == 2
    assert facts["evaluations"][0]["files"][0]["path_efficiency"] is None, "a number that is none"
    assert str(tmp_path) not in report.to_json()
    assert facts["runs"][0]["config"]["backward_reward"] == {"artifact": "artifact"}


def test_the_steps_that_a_scripted_controller_flies_are_told_in_steps_and_episodes(tmp_path: Path) -> None:
    flown = {"demonstrator___target_": "somebody.s", "algo__learning_starts": 45}
    folders = [
        run_folder(tmp_path / "shown0", "a" * 9, {"demonstrator": "vfh"}, seed=0, **flown),
        run_folder(tmp_path / "shown1", "a" * 3, {"demonstrator": "vfh"}, seed=1, **flown),
        run_folder(tmp_path / "alone", "c" * 9, algo__learning_starts=45),
    ]
    report = make_report(folders, window=2)
    assert [group["demonstrated"] for group in report.groups] == [{"steps": 45, "episodes": 4}, None]
    text = re.sub(r"\s+", " ", page(report))
    assert f"In the grey band a scripted controller flies: the first 45 steps of {report.groups[0]['label']}." in text
    bands = re.findall(r'"type":"rect","x0":0,"x1":(\d+)', text)
    assert bands == ["45"] * 4 + ["4"] * 4, "one in each figure over steps, and one in each over episodes"
    assert "grey band" not in page(make_report(folders[2:], window=2))
