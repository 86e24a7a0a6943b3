"""The Python of the how-to pages runs from top to bottom, and their yaml composes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.commands import TINY, in_process
from tests.helpers.finished import finished_run
from tests.helpers.folders import ROOT
from uavrl.cli import export
from uavrl.config import compose, validate
from uavrl.envs import NavigationEnv
from uavrl_onboard.perception.reductions import truncated_icosahedron

PAGES = {page.stem: page for page in [*sorted((ROOT / "docs/howto").glob("*.md")), ROOT / "docs/lidar.md"]}


def blocks(page: str, kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)```", PAGES[page].read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Runs a page's Python in a folder of its own; returns the names that it makes."""
    monkeypatch.chdir(tmp_path)

    def go(page: str) -> dict[str, Any]:
        names: dict[str, Any] = {}
        exec(compile("\n".join(blocks(page, "python")), page, "exec"), names)
        return names

    return go


def test_each_page_with_python_is_run_here() -> None:
    assert {page for page in PAGES if blocks(page, "python")} == {
        *("data", "gpu", "guards", "lidar", "moving_obstacles", "onnx", "sensors", "teachers", "vehicle")
    }


def test_a_point_cloud(run: Any) -> None:
    names = run("lidar")
    assert names["cells"].shape == (72,) and names["faces"].shape == (8, 32)
    np.testing.assert_allclose(names["faces"][7], truncated_icosahedron(names["points"]), atol=1e-6)
    assert names["transform"].in_keys == ["point_cloud"]


def test_a_teacher_along_the_way(run: Any) -> None:
    teacher = run("teachers")["AlongTheWay"]()
    env = NavigationEnv(2, world={"obstacles": 0}, privileged=teacher.in_keys, blind=True, max_steps=400)
    flown = env.rollout(400, teacher)
    assert flown["next", "arrived"].any() and not flown["next", "collided"].any()
    env.close()


def test_a_sensor(run: Any) -> None:
    names = run("sensors")
    assert names["mine"].num_rays == 3600
    names["env"].close()


def test_a_vehicle(run: Any) -> None:
    names = run("vehicle")
    assert names["env"].airframe.mass == 1.9
    assert all(0.8 <= plant.mass <= 1.2 for plant in names["env"].vehicle_params)
    names["env"].close()


def test_a_vehicle_of_ones_own_composes(tmp_path: Path) -> None:
    (content,) = blocks("vehicle", "yaml")
    (tmp_path / "env").mkdir()
    (tmp_path / "env/mine.yaml").write_text(content)
    assert "uavrl-train --config-dir my_conf env=mine preset=dagger\n" in blocks("vehicle", "sh")[1]
    config = compose("env=mine", "preset=dagger", own=[tmp_path])
    validate(config)
    assert config.env.airframe.mass == 1.9 and config.env.airframe.tilt_limit == 0.5
    assert config.env.num_uavs == 16 and config.env.randomize.mass == [0.8, 1.2]


def test_moving_obstacles(run: Any) -> None:
    names = run("moving_obstacles")
    assert names["env"].plane_poses().shape == (5, 4) and names["env"].plane_paths(10).shape == (10, 5, 4)
    assert names["steps"].shape == (1, 3)
    names["env"].close()
    names["flown"].close()


def test_guards(run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    names = run("guards")
    assert names["steps"].shape == (1, 3) and names["guards"].settings.names == ("map", "evasion", "shield")
    assert names["turn"].shape == (1,)
    assert "[[1.2" in capsys.readouterr().out, "the shield slows the vehicle"
    names["env"].close()


def test_a_device_that_fits_each_machine(run: Any) -> None:
    assert run("gpu")["policy"].source["training_steps"] > 0


def test_the_data_of_a_run(run: Any, tmp_path: Path) -> None:
    chosen = ["preset=dagger", "collector=sync", "env.world.seeds=[0]"]
    folder = finished_run(tmp_path / "run", *TINY, *chosen)
    (command,) = blocks("data", "sh")
    command = command.replace("RUN_FOLDER", str(folder))
    assert in_process(export.main, *command.split()[1:]) == 0
    names = run("data")
    assert sum(names["losses"][-5:]) < 0.3 * sum(names["losses"][:5])
    assert names["batch"]["observation"].shape == (256, 237)
    wide, kept = (set(names[name].keys(True, True)) for name in ("batch", "data"))
    assert wide - {"index"} == kept
    told = re.findall(r"^\| `(\w+)` \|", PAGES["data"].read_text(encoding="utf-8"), re.MULTILINE)
    assert {key for key in told if key != "privileged"} == set(names["data"].keys())


def test_an_exported_policy(run: Any) -> None:
    assert "uavrl-export policy=best output=my_policy " in blocks("onnx", "sh")[0]
    assert in_process(export.main, "policy=best", "output=my_policy") == 0
    names = run("onnx")
    assert names["actions"].shape == (1, 4) and names["action"].shape == (4,)
    assert (np.abs(names["action"]) <= 2.0).all() and names["policy"].contract.rate_hz == 10
