from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.reporting.folders import DOCUMENTED, ROOT, evaluation, run_folder
from uavrl.errors import UavrlError
from uavrl.reporting.learning_curves import curves
from uavrl.reporting.report import make_report
from uavrl.reporting.thesis import thesis
from uavrl.training.episodes import Episode


def by(rows: list[dict[str, Any]], key: str, value: Any) -> dict[str, Any]:
    (found,) = [row for row in rows if row[key] == value]
    return found


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
    assert group["notes"] == []


def test_curves_of_seeds_that_end_at_different_episodes() -> None:
    def seed(outcomes: str, length: int) -> list[Episode]:
        names = {"a": "arrived", "c": "collided"}
        return [
            Episode(i + 1, length * (i + 1), names[o], float(i), length, 0, 0, 0, 0, 0, 0, 0, i)
            for i, o in enumerate(outcomes)
        ]

    found = curves([seed("ca", 10), seed("aaa", 5)], window=2)
    curve = found["success"]["episodes"]
    assert curve.seeds == [([1, 2], [0.0, 0.5]), ([1, 2, 3], [1.0, 1.0, 1.0])]
    assert (curve.x, curve.mean, curve.low, curve.high) == ([1, 2], [0.5, 0.75], [0.0, 0.5], [1.0, 1.0])
    steps = found["return"]["steps"]
    assert steps.x == [10, 11, 12, 13, 14, 15], "from where both seeds have flown to where the first ends"
    # The first seed has its first episode there, whose return is 0; the second its last two, or its last two but one.
    assert steps.low == [0.0] * 6 and steps.high == [0.5, 0.5, 0.5, 0.5, 0.5, 1.5]


def test_one_seed_is_warned_of_and_not_tested(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "ca")
    report = make_report([tmp_path], window=2)
    (warning,) = report.warnings()
    assert warning.startswith("td3: One seed (0)")
    (part,) = report.comparisons
    assert part["tests"] == [] and part["iqm"][0]["low"] is None
    assert part["reading"] == [
        "No pair is tested: that takes two groups with two seeds or more each.",
        "One seed, so neither interval nor test: td3.",
    ]
    assert report.curves["td3"]["success"]["steps"]["x"] == []


def test_two_seeds_are_tested_and_said_to_show_little(tmp_path: Path) -> None:
    for name, seed, outcomes in (("a", 0, "aaac"), ("b", 1, "aacc")):
        run_folder(tmp_path / "td3" / name, outcomes, seed=seed)
    for name, seed, outcomes in (("c", 0, "aaaa"), ("d", 1, "aaac")):
        run_folder(tmp_path / "gamma" / name, outcomes, seed=seed, algo__gamma=0.9)
    report = make_report([tmp_path], window=4)
    (part,) = report.comparisons
    (test,) = part["tests"]
    assert (test["first"], test["second"], test["difference"]) == ("td3 · gamma=0.9", "td3 · gamma=0.99", 0.25)
    assert test["permutation_holm"] == pytest.approx(2 / 3) and test["least"] == pytest.approx(1 / 3)
    # t = 0.25 / √(0.03125 / 2 + 0.03125 / 2) = √2, two degrees of freedom: p = 1 - t / √(t² + 2)
    assert test["welch_holm"] == pytest.approx(0.292893, abs=1e-6)
    assert "no p below 0.33: it cannot call any difference significant" in part["reading"][0]
    assert part["reading"][1].startswith("Two seeds show next to nothing")


def test_evaluations_that_all_seeds_flew_alike_are_compared(tmp_path: Path) -> None:
    for seed, arrived, other in ((0, 8, 6), (1, 10, 4)):
        folder = run_folder(tmp_path / f"run{seed}", "ca", seed=seed)
        evaluation(folder, arrived, 10)
        evaluation(folder, other, 10, "evaluation_valleys=100.json", valleys=[100])
    evaluation(tmp_path / "run0", 1, 10, "evaluation_seed=7.json", seed=7)
    report = make_report([tmp_path], window=2)
    assert len(report.evaluations) == 5
    part = by(report.comparisons, "score", "evaluation")
    assert part["tasks"] == [
        "static, valleys [0], 10 tasks of seed 20000",
        "static, valleys [100], 10 tasks of seed 20000",
    ]
    # 0.8, 0.6, 1.0, 0.4: one is cut off at each end
    assert part["iqm"][0]["value"] == pytest.approx(0.7)


def test_what_is_not_compared_is_said(tmp_path: Path) -> None:
    for name, gamma, seed in (("a0", 0.9, 0), ("a1", 0.9, 1), ("b0", 0.99, 0)):
        run_folder(tmp_path / name, "ca", seed=seed, algo__gamma=gamma)
    evaluation(tmp_path / "a0", 8, 10)
    evaluation(tmp_path / "b0", 8, 10)
    (part,) = (p for p in make_report([tmp_path], window=2).comparisons if p["score"] == "evaluation")
    assert [row["group"] for row in part["iqm"]] == ["td3 · gamma=0.99"]
    assert part["reading"][-1] == "The evaluations of td3 · gamma=0.9 are not compared: seed 1 has none."
    evaluation(tmp_path / "a1", 8, 10)
    evaluation(tmp_path / "b0", 8, 10, seed=7)
    (part,) = make_report([tmp_path], window=2).comparisons
    assert part["reading"][-1].startswith("No evaluation is compared: none was flown alike by all seeds of")


def test_planes_move_with_the_steps_of_all(tmp_path: Path) -> None:
    for seed, count in ((0, 8), (1, 4)):
        folder = run_folder(tmp_path / f"run{seed}", "ca", seed=seed)
        evaluation(folder, 8, 10, num_uavs=count)
        evaluation(folder, 5, 10, "evaluation_env=dynamic.json", env="dynamic", num_uavs=count)
        added = {"overrides": ["env.world.planes=3"], "num_uavs": count}
        evaluation(folder, 5, 10, "evaluation_env.world.planes=3.json", **added, **({"planes": 3} if seed else {}))
    part = by(make_report([tmp_path], window=2).comparisons, "score", "evaluation")
    assert part["tasks"] == ["static, valleys [0], 10 tasks of seed 20000"]


def test_runs_of_different_length_are_named(tmp_path: Path) -> None:
    def sentences() -> list[str]:
        (part,) = make_report([tmp_path], window=2).comparisons
        return [sentence for sentence in part["reading"] if "equally long" in sentence]

    run_folder(tmp_path / "run0", "caca", seed=0)
    run_folder(tmp_path / "run1", "acac", seed=1)
    assert not sentences()
    run_folder(tmp_path / "run2", "aca", seed=0, algo__gamma=0.9)
    assert sentences() == ["The runs have not flown equally long: 3 to 4 episodes, of which the last count."]


def test_of_two_evaluations_of_the_same_the_longer_trained_counts(tmp_path: Path) -> None:
    for seed in (0, 1):
        folder = run_folder(tmp_path / f"run{seed}", "ca", seed=seed)
        evaluation(folder, 8, 10, training_steps=40 + seed)
        evaluation(folder, 1, 10, "evaluation_checkpoint=early.json", training_steps=20)
        evaluation(folder, 0, 10, "evaluation_policy=straight.json", policy="straight", valleys=[5])
        older = "evaluation_env.max_steps=9_env.world.size=-3_num=1.json"
        newer = {"overrides": ["seed=3", "env.world.size=-3", "env.max_steps=9"]}
        evaluation(folder, 5, 10, *([older] if seed else ["evaluation_anything.json"]), **({} if seed else newer))
    part = by(make_report([tmp_path], window=2).comparisons, "score", "evaluation")
    same = "static, valleys [0], 10 tasks of seed 20000"
    assert part["tasks"] == [same, f"{same} with env.max_steps=9, env.world.size=-3"]
    assert part["iqm"][0]["value"] == pytest.approx((0.8 + 0.5) / 2)
    assert part["reading"][-1] == (
        f"In {same}, the checkpoints have not trained equally long: 40 to 41 steps (0 where it is not recorded)."
    )
    assert sum("equally long" in sentence for sentence in part["reading"]) == 1


def test_the_thesis_has_the_numbers_of_its_figures() -> None:
    def rates(env: str, reward: str) -> dict[str, tuple[float, float | None]]:
        rows = [r for r in thesis()["rates"] if (r["env"], r["reward"]) == (env, reward)]
        return {row["learner"]: (row["success"], row["collision"]) for row in rows}

    assert rates("static", "TR") == {
        "ddpg": (0.378, 0.606),
        "td3": (0.422, 0.51),
        "td3_fork": (0.558, 0.386),
        "td3_lg": (0.62, 0.264),
    }
    assert rates("static", "ABR⁺") == {
        "ddpg": (0.586, 0.374),
        "td3": (0.824, 0.116),
        "td3_fork": (0.786, 0.182),
        "td3_lg": (0.886, 0.088),
    }
    assert rates("dynamic", "TR") == {"td3": (0.37, 0.574)}
    assert rates("dynamic", "ABR⁺") == {"td3": (0.696, 0.266), "td3_fork": (0.71, 0.252), "td3_lg": (0.734, 0.256)}
    assert rates("static", "ABR") == {"td3": (0.848, None)} and rates("dynamic", "ABR") == {"td3": (0.632, None)}
    assert [(r["env"], r["learner"], r["threshold"], r["steps"]) for r in thesis()["steps_to"]] == [
        ("static", "td3_fork", 0.78, 950_000),
        ("static", "td3_lg", 0.78, 410_000),
        ("dynamic", "td3_fork", 0.74, 390_000),
        ("dynamic", "td3_lg", 0.74, 320_000),
    ]


def test_groups_stand_beside_the_row_that_they_repeat(tmp_path: Path) -> None:
    lifeguard = {"model": "mlp"}
    run_folder(tmp_path / "a", "ca", reward={"name": "traditional"})
    run_folder(tmp_path / "b", "aa", backward_reward={"name": "abr_plus"}, algo__lifeguard=lifeguard)
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
    assert list(report.thesis["without_row"]) == ["td3 · navigation_prize"]


def test_settings_that_differ(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "a", seed=0, algo__gamma=0.9, trainer__execution="compiled")
    run_folder(tmp_path / "b", "a", seed=1, algo__gamma=0.9, trainer__execution="captured")
    run_folder(tmp_path / "c", "a", run_dir="elsewhere")
    assert make_report([tmp_path], window=1).settings == {
        "algo.gamma": ["0.9", "0.99"],
        "trainer.execution": ["compiled / captured", "–"],
    }


def test_what_is_wrong_is_told_and_the_rest_reported(tmp_path: Path) -> None:
    run_folder(tmp_path / "good", "ca", trainer__episodes=7)
    (run_folder(tmp_path / "bad", "ca", seed=1) / "config.yaml").unlink()
    report = make_report([tmp_path, tmp_path / "nowhere"], window=5)
    assert [run["name"] for run in report.runs] == ["good"]
    assert report.warnings() == [
        f"{tmp_path / 'nowhere'} is left out. There is no such folder: check the path.",
        f"{tmp_path / 'bad'} is left out. config.yaml is missing, which holds the configuration of the run: "
        "bring it back, or leave the folder out.",
        "good: Unfinished: 2 of 7 episodes.",
        "good: It has flown fewer than 5 episodes: its rates are over all 2.",
        "td3: One seed (0): it shows what happened once, not what to expect.",
    ]


def test_seeds_of_different_length_are_told(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "ca", seed=0)
    run_folder(tmp_path / "b", "cac", seed=1)
    notes = make_report([tmp_path], window=2).groups[0]["notes"]
    assert "end where the first seed ends (over episodes: seed 0 after 2)" in notes[-1]


def test_nothing_left_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match=r"nothing to report.*no such folder"):
        make_report([tmp_path / "nowhere"])


@pytest.mark.parametrize("wrong", [{"window": 0}, {"threshold": 0.0}, {"threshold": 1.5}, {"threshold": float("nan")}])
def test_numbers_out_of_range(tmp_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises(UavrlError, match="must be"):
        make_report([tmp_path], **wrong)


def test_json_gives_back_the_facts(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "a", "ca")
    evaluation(folder, 8, 10)
    rows = (folder / "episodes.csv").read_text().replace(",100.0,", ",nan,")
    (folder / "episodes.csv").write_text(rows)
    report = make_report([tmp_path], window=2)
    assert json.loads(report.to_json()) == report.facts()
    assert report.facts()["runs"][0]["last"]["mean_return"] is None, "a number that is none"
    assert report.facts()["format"] == 1


def test_the_documented_runs_give_the_documented_numbers() -> None:
    report = make_report(DOCUMENTED, threshold=0.6)
    found = {(r["group"], r["seed"]): (r["last"]["success"]["rate"], r["steps_to_threshold"]) for r in report.runs}
    assert found == {  # docs/journal/open_valley.md
        ("td3", 0): (0.84, 65_980),
        ("td3", 1): (0.938, 131_838),
        ("td3_fork", 0): (0.932, 56_777),
        ("td3_lg", 0): (0.94, 59_690),
        ("td3_lg_mlp", 0): (0.79, 72_918),
        ("td3_lg_mlp", 1): (0.748, 87_191),
    }


def test_a_report_needs_neither_torch_nor_pybullet() -> None:
    code = (
        "import sys, pathlib\n"
        "from uavrl.reporting.page import page; from uavrl.reporting.report import make_report\n"
        "page(make_report([pathlib.Path('docs/journal/data/enhancers/td3_seed0')]))\n"
        "assert not {'torch', 'tensordict', 'pybullet'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=600)
