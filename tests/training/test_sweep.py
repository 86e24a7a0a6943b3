"""The folder of a combination says what distinguishes it."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.helpers.configs import composed
from uavrl.cli import sweep_runs
from uavrl.config import resolve
from uavrl.errors import UavrlError
from uavrl.training.sweep import require_same_run, run_folder


def named(run_dir: str, overrides: list[str], swept: list[str]) -> str:
    sweep_runs.forget()
    sweep_runs.note_swept([*swept, "-m", "--config-dir", "conf", "run_dir=a b"])
    told = sweep_runs.differences([*overrides, f"run_dir={run_dir}"], {})
    return str(run_folder(composed("config", *overrides, f"run_dir='{run_dir}'"), told))


@pytest.mark.parametrize(
    ("run_dir", "overrides", "swept", "expected"),
    [
        ("g", ["algo.gamma=0.98", "seed=1"], ["algo.gamma=0.98,0.99", "seed=0,1"], "g_gamma=0.98_seed=1"),
        ("g/", ["algo.gamma=0.98", "seed=1"], ["algo.gamma=0.98,0.99", "seed=1"], "g/gamma=0.98_seed=1"),
        ("g", ["algo.gamma=0.98", "seed=1"], ["seed=0,1"], "g_seed=1"),
        ("g", ["algo.hidden=[8,8]"], ["algo.hidden=[8,8],[16,16]"], "g_hidden=8-8_seed=0"),
        ("g${seed}", ["seed=3", "algo.n_steps=2"], ["seed=3,4", "algo.n_steps=1,2"], "g3_n_steps=2"),
        ("g_${seed}", ["seed=3"], ["seed=3,4", "trainer.episodes=5,6", "device=cpu,cuda"], "g_3"),
        ("${uavrl_run_name:}_${seed}", ["env=dynamic"], ["env=static,dynamic"], "dynamic_td3_navigation_prize_0"),
    ],
)
def test_a_folder_says_what_the_sweep_varies(
    run_dir: str, overrides: list[str], swept: list[str], expected: str
) -> None:
    assert named(run_dir, overrides, swept) == expected


def test_a_long_name_is_cut_and_stays_unlike_others() -> None:
    swept = ["algo.hidden=[8],[16]"]
    long = [named("g", [f"algo.hidden=[{'8,' * 60}{last}]"], swept) for last in (8, 16)]
    assert long[0] != long[1] and max(map(len, long)) < 140


def test_the_values_of_an_experiment_s_own_sweep_are_known() -> None:
    sweep_runs.forget()
    params = {"env": "static,dynamic", "learner": "td3"}
    assert sweep_runs.differences(["env=dynamic", "learner=td3", "seed=1"], params) == {"env": "dynamic"}


def test_a_folder_of_other_settings_is_refused_with_what_differs(finished: Path) -> None:
    config = resolve(OmegaConf.merge(OmegaConf.load(finished / "config.yaml"), {"trainer": {"episodes": 9}}))
    require_same_run(finished, config)
    require_same_run(finished / "none", config)
    config.algo.gamma = 0.5
    with pytest.raises(UavrlError, match=r"other settings \(algo.gamma is 0.99, not 0.5\): choose another run_dir"):
        require_same_run(finished, config)
