"""The benchmarks run and write what the documentation quotes."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(path for folder in ("benchmarks", "studies") for path in (ROOT / folder).glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_every_script_ends_in_one_sentence(script: Path) -> None:
    begun, _, started = script.read_text().partition('if __name__ == "__main__":\n')
    assert started == ("    with one_sentence():\n        main()\n" if "\ndef main(" in begun else "")


def test_minutes_are_counted_until_enough_of_the_last_flights_arrive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Flights end at 1, 2, 3, 4, 5 minutes; the share of the last two is 0, ½, 1, ½ from the second on."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import minutes

    (tmp_path / "logs/run/scalars").mkdir(parents=True)
    (tmp_path / "logs/run/scalars/minutes.csv").write_text("100,1.0\n500,5.0\n")
    outcomes = ["collided", "timed_out", "arrived", "arrived", "collided"]
    rows = [f"{100 * (k + 1)},{outcome}" for k, outcome in enumerate(outcomes)]
    (tmp_path / "episodes.csv").write_text("\n".join(["total_steps,outcome", *rows]) + "\n")
    curve = minutes.read(tmp_path)
    assert curve.minutes.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert curve.success(2).tolist() == [0.0, 0.5, 1.0, 0.5]
    assert curve.reaches(0.5, 2) == (3.0, 300)
    assert curve.reaches(0.8, 2) == (4.0, 400)
    assert curve.reaches(0.8, 3) is None
    never = minutes.Curve(curve.minutes, curve.steps, np.zeros(5))
    asked = SimpleNamespace(success=0.8, window=2)
    result = minutes.told({minutes.DEFAULT: [curve, curve, never], minutes.FAST: [curve, never, never]}, asked)
    assert result["rows"][minutes.DEFAULT] == {
        "minutes": [4.0, 4.0, None],
        "steps": [400, 400, None],
        "median_minutes": 4.0,
    }
    assert result["rows"][minutes.FAST]["median_minutes"] is None
    assert result["fast_vs_default"] is None
    minutes.draw({minutes.DEFAULT: [curve, curve]}, 2, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 1000


@pytest.mark.parametrize("cached", [[], ["--cached"]])
def test_make_train_is_timed_and_its_policies_are_evaluated(
    cached: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import make_train

    made: list[tuple[list[str], bool]] = []

    def timed(command: list[str], cache: Path) -> tuple[float, float]:
        made.append((command, cache.exists()))
        cache.mkdir(exist_ok=True)
        if command[0] == "make":
            run = Path(command[2].removeprefix("RUN="))
            run.mkdir()
            (run / "summary.json").write_text(json.dumps({"minutes": 2.0, "steps": 30_000, "updates": 12_000}))
        return 60.0 * (3 + len(made)), 480.0

    def evaluated(command: list[str], **_: object) -> None:
        folder = Path(command[-1].removeprefix("output="))
        folder.mkdir(exist_ok=True)
        for name, rate in (("held_out", 0.99), ("dense", 0.9 + 0.01 * len(made))):
            (folder / f"{name}.json").write_text(json.dumps({"success": {"rate": rate}}))

    monkeypatch.setattr(make_train, "timed", timed)
    monkeypatch.setattr(make_train.subprocess, "run", evaluated)
    output = tmp_path / "numbers.json"
    command = ["make_train.py", "--folder", str(tmp_path), "--seeds", "3", *cached, "--json", str(output)]
    monkeypatch.setattr("sys.argv", command)
    make_train.main()
    made_again = len(made)
    make_train.main()
    assert len(made) - made_again == len(cached), "what is there is not run again"
    trained = [(command, full) for command, full in made if command[0] == "make"]
    assert [command[3] for command, _ in trained] == ["ARGS=seed=0", "ARGS=seed=1", "ARGS=seed=2"]
    assert [full for _, full in trained] == [bool(cached)] * 3
    first = 4 + len(cached)
    found = json.loads(output.read_text())
    assert [row["minutes"] for row in found["rows"]] == [first, first + 1, first + 2]
    assert (found["median"]["minutes"], found["median"]["cpu_minutes"]) == (first + 1, 8.0)
    assert found["median"]["held_out"] == pytest.approx(99.0)
    assert capsys.readouterr().out.splitlines()[-1].split()[:2] == ["median", f"{first + 1:.1f}"]


def test_pybullets_rays_see_what_the_lidar_sees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from pybullet_rays import PyBulletLidar

    from uavrl.envs import Lidar, LidarConfig, World, WorldConfig

    world, config = World(WorldConfig()), LidarConfig(max_range=4.0)
    tilted = Rotation.from_euler("zyx", [[0.3, 0.1, -0.2]]).as_matrix()
    places = world.sample_task(np.random.default_rng(0)).start[None]
    ours = Lidar(world.meshes, None, config).scan(places, tilted)
    theirs = PyBulletLidar(world.meshes, config).scan(places, tilted)
    both = np.isfinite(ours).all(-1) & np.isfinite(theirs).all(-1)
    assert both.sum() > 1000
    assert (np.isnan(ours) != np.isnan(theirs)).mean() < 1e-3  # at the range's end and at edges
    np.testing.assert_allclose(ours[both], theirs[both], atol=1e-3)


def test_the_valley_with_pybullets_rays_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from pybullet_rays import PyBulletLidar, PyBulletValleyEnv

    casts: list[int] = []
    cast = PyBulletLidar._cast
    monkeypatch.setattr(PyBulletLidar, "_cast", lambda self, *pose: casts.append(1) or cast(self, *pose))
    env = PyBulletValleyEnv()
    start, _ = env.reset(seed=0)
    state, reward, *_ = env.step(np.array([2.0, 0.0, 0.0, 0.0], dtype=np.float32))
    env.close()
    assert state.shape == start.shape and np.isfinite(reward)
    assert len(casts) == 2  # one scan each


def test_the_stopwatch_gives_each_second_to_the_innermost_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import profiling

    now = iter(range(100)).__next__
    monkeypatch.setattr(profiling, "time", SimpleNamespace(perf_counter=now))
    owner = SimpleNamespace(inner=lambda: None)
    owner.outer = lambda: owner.inner()
    before = dict(vars(owner))
    stopwatch = profiling.Stopwatch("rest")  # reads 0
    with stopwatch.watching({"outer": [(owner, "outer")], "inner": [(owner, "inner")]}):
        owner.outer()  # begins at 1, its inner one lasts from 2 to 3, ends at 4
    assert stopwatch.stop() == {"rest": 2, "outer": 2, "inner": 1}  # stops at 5
    assert vars(owner) == before


def test_the_policy_of_a_minute_is_that_of_the_last_checkpoint_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import unseen

    ends = {"checkpoint-0": (0, 0.0), "checkpoint-1": (5, 31.0), "checkpoint-2": (9, 59.0), "checkpoint-3": (20, 130.0)}
    (tmp_path / "checkpoints").mkdir()
    for name in ends:
        (tmp_path / "checkpoints" / name).touch()

    def manifest(path: Path) -> dict[str, Any]:
        return {"metadata": dict(zip(("episodes", "seconds"), ends[path.name], strict=True))}

    monkeypatch.setattr(unseen.Checkpoint, "manifest", manifest)
    found = unseen.by_minute(tmp_path)
    assert {at: Path(policy[1].partition("=")[2]).name for at, policy in found.items()} == {
        1: "checkpoint-2",
        3: "checkpoint-3",
    }
    (tmp_path / "minute_007.zip").touch()
    assert list(unseen.by_minute(tmp_path)) == [7]
