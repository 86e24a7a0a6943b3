from __future__ import annotations

from pathlib import Path

from tests.reporting.folders import run_folder
from uavrl.reporting.groups import HOW_IT_RUNS, group_runs, same_task
from uavrl.reporting.runs import read_runs
from uavrl.training.checkpoint import FREE_KEYS


def test_what_a_continuation_may_change_parts_no_group() -> None:
    assert set(FREE_KEYS) <= set(HOW_IT_RUNS)


def test_seeds_of_one_configuration_are_one_group(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "aa", seed=1, trainer__execution="captured")
    run_folder(tmp_path / "b", "acc", seed=0, trainer__execution="compiled", logger__name="wandb")
    run_folder(tmp_path / "c", "acc", seed=2)
    (group,), left_out = group_runs(read_runs([tmp_path])[0])
    assert (group.label, group.seeds, left_out) == ("td3", [0, 1, 2], [])
    assert group.notes == [
        "Its runs differ in trainer.episodes: 3 (seed 0), 2 (seed 1), 3 (seed 2).",
        "Its runs differ in trainer.execution: compiled (seed 0), captured (seed 1), not recorded (seed 2).",
    ]


def test_labels_say_what_differs(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "a")
    run_folder(tmp_path / "b", "a", reward={"name": "traditional"})
    run_folder(tmp_path / "c", "a", backward_reward={"name": "abr_plus"})
    run_folder(tmp_path / "d", "a", algo__gamma=0.9)
    groups, _ = group_runs(read_runs([tmp_path])[0])
    assert [group.label for group in groups] == [
        "td3 · navigation_prize · gamma=0.99",
        "td3 · traditional",
        "td3_abr_plus · navigation_prize",
        "td3 · navigation_prize · gamma=0.9",
    ]


def test_a_label_names_the_group_of_another_choice(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "a", collector__name="sync")
    run_folder(tmp_path / "b", "a", collector__name="async")
    groups, _ = group_runs(read_runs([tmp_path])[0])
    assert [group.label for group in groups] == ["td3 · collector=sync", "td3 · collector=async"]


def test_a_seed_counts_once(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "aca")
    run_folder(tmp_path / "b", "acac")
    run_folder(tmp_path / "c", "cc")
    (group,), left_out = group_runs(read_runs([tmp_path])[0])
    assert [run.name for run in group.runs] == ["b"]
    assert [(Path(left.folder).name, left.reason) for left in left_out] == [
        ("a", f"It is a copy of {tmp_path / 'b'}, and a seed counts once."),
        ("c", f"It is another run of the same configuration and seed as {tmp_path / 'b'}, and a seed counts once."),
    ]


def test_another_task_is_left_out(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "a", seed=0, env__num_uavs=4)
    run_folder(tmp_path / "b", "a", seed=1)
    run_folder(tmp_path / "c", "a", seed=0, env__name="dynamic", env__world__planes=3)
    run_folder(tmp_path / "d", "a", seed=0, perception__radius=2.0)
    runs, _ = read_runs([tmp_path])
    kept, left_out = same_task(runs)
    assert [run.name for run in kept] == ["a", "b"]
    assert same_task([runs[0], runs[2]])[1][0].reason.startswith("It flies another task than the run reported (")
    told = "It flies another task than the 2 runs reported"
    assert [left.reason for left in left_out] == [
        f"{told} (env is dynamic, not static; env.world.planes is 3, not 0): give it a report of its own.",
        f"{told} (perception.radius is 2, not 4): give it a report of its own.",
    ]
