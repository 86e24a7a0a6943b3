from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.folders import run_folder
from uavrl.config import compose
from uavrl.evaluation.policies import PACKAGED
from uavrl.reporting.groups import HOW_IT_RUNS, group_runs, same_task
from uavrl.reporting.runs import read_runs
from uavrl.runs.config import FREE_KEYS, load_config
from uavrl.runs.labels import label


def labels(folder: Path) -> list[str]:
    return [group.label for group in group_runs(read_runs([folder])[0])[0]]


def test_what_a_continuation_may_change_parts_no_group() -> None:
    assert set(FREE_KEYS) <= set(HOW_IT_RUNS)


def test_seeds_of_one_configuration_are_one_group(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "aa", seed=1, trainer__execution="captured")
    run_folder(tmp_path / "b", "acc", seed=0, trainer__execution="compiled", logger__name="wandb")
    run_folder(tmp_path / "c", "acc", seed=2)
    (group,), left_out = group_runs(read_runs([tmp_path])[0])
    assert (group.label, group.seeds, left_out) == ("TD3, prize", [0, 1, 2], [])


def test_labels_say_what_differs(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "a")
    run_folder(tmp_path / "b", "a", {"reward": "traditional"})
    run_folder(tmp_path / "c", "a", {"backward_reward": "abr_plus", "reward": "navigation"})
    run_folder(tmp_path / "d", "a", algo__gamma=0.9)
    run_folder(tmp_path / "e", "a", {"collector": "async"}, algo__gamma=0.9)
    assert labels(tmp_path) == [
        "TD3, prize · collector=sync · gamma=0.99",
        "TD3, TR",
        "TD3 + ABR⁺, Eq. 3.6",
        "TD3, prize · collector=sync · gamma=0.9",
        "TD3, prize · collector=async · gamma=0.9",
    ]


def test_a_part_of_somebody_elses_is_called_by_its_yaml() -> None:
    assert (
        label(
            {"algo": "ppo", "actor_penalty": "mine", "smoothness": "none", "reward": "hover", "backward_reward": "none"}
        )
        == "PPO-mine, hover"
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (["preset=dagger"], "DAgger"),
        (["preset=td3_bc", "algo.n_steps=1"], "TD3-BC"),
        (
            ["preset=td3_bc", "reward_preset=prize", "smoothness=none"],
            "TD3-BC, smoothness=none, reward=navigation_prize",
        ),
        (["preset=thesis"], "TD3, TR"),
        (["algo=sac", "fork=on"], "SAC-FORK, prize"),
    ],
)
def test_a_preset_gives_its_name_and_what_differs_from_it_is_added(changes: list[str], expected: str) -> None:
    assert label({str(key): str(choice) for key, choice in compose(*changes).choices.items()}) == expected


def test_the_packaged_policies_have_the_name_of_their_method() -> None:
    for name in ("best", "best_dynamic"):
        choices = load_config(PACKAGED / name / "config.yaml").choices
        assert label({str(key): str(choice) for key, choice in choices.items()}) == "TD3-BC"


def test_a_seed_counts_once_by_its_longest_run(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "aca")
    run_folder(tmp_path / "b", "acac")
    (group,), (left,) = group_runs(read_runs([tmp_path])[0])
    assert [run.name for run in group.runs] == ["b"]
    assert left.folder == "a" and "seed of b" in left.reason


def test_another_task_is_left_out(tmp_path: Path) -> None:
    run_folder(tmp_path / "a", "a", seed=0, env__num_uavs=4)
    run_folder(tmp_path / "b", "a", seed=1)
    run_folder(tmp_path / "c", "a", {"env": "dynamic"}, seed=0, env__world__planes=3)
    run_folder(tmp_path / "d", "a", seed=0, perception__radius=2.0)
    kept, left_out = same_task(read_runs([tmp_path])[0])
    assert [run.name for run in kept] == ["a", "b"]
    dynamic, near = (left.reason for left in left_out)
    assert "(env is dynamic, not static; env.world.planes is 3, not 0)" in dynamic
    assert "(perception.radius is 2, not 4)" in near
