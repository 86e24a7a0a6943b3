"""The benchmarks run and write what the documentation quotes."""

from __future__ import annotations

import gzip
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.helpers.configs import with_run_dir
from tests.helpers.folders import episodes, evaluation, write_episodes
from uavrl.errors import UavrlError
from uavrl.runs.episodes import wilson
from uavrl.runs.provenance import commit
from uavrl.training.run import create_run

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize("script", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_every_script_ends_in_one_sentence(script: Path) -> None:
    begun, _, started = script.read_text().partition('if __name__ == "__main__":\n')
    assert started == ("    with one_sentence():\n        main()\n" if "\ndef main(" in begun else "")


def test_two_evaluations_are_compared_task_by_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of six tasks one success is lost and two are won; a time-out in a collision's place changes no success."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import outcomes

    one = evaluation(tmp_path, 3, 6, "one.json", outcomes="SSCTSC")
    ends = {"S": "arrived", "C": "collided", "T": "timed_out"}
    older = [{"task": task, "outcome": ends[letter]} for task, letter in enumerate("CSSSST")]
    other = evaluation(tmp_path, 4, 6, "other.json", flights=older)
    (tmp_path / "suite.json").write_text(json.dumps({"static": json.loads(other.read_text())}))
    found = outcomes.compared(*map(outcomes.evaluation, (str(one), f"{tmp_path / 'suite.json'}:static")))
    assert found == {"tasks": 6, "success": [3, 4], "changed": 4, "lost": 1, "won": 2, "p": pytest.approx(1.0)}
    monkeypatch.setattr(sys, "argv", ["outcomes.py", str(one), str(other)])
    outcomes.main()
    assert "66.7% of the outcomes differ: 1 successes lost, 2 won" in capsys.readouterr().out
    with pytest.raises(UavrlError, match="same tasks, they differ by seed and env"):
        outcomes.compared(outcomes.evaluation(str(one)), {**outcomes.evaluation(str(one)), "seed": 1, "env": "dynamic"})
    (tmp_path / "suite.json").write_text(json.dumps({"static": {"episodes": 6}}))
    for place, told in ((f"{tmp_path}/suite.json:static", "does not tell how"), (f"{tmp_path}/no.json", "Expected an")):
        with pytest.raises(UavrlError, match=told):
            outcomes.evaluation(place)


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


def test_methods_are_compared_by_what_is_kept_of_their_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten flights of ten steps a run; the better method's last four arrive, of the other's the last alone."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import methods

    folders = []
    for method, ends in (("good", "ccccctaaaa"), ("poor", "ccccccctta")):
        for seed in range(5):
            run = tmp_path / f"{method}{seed}"
            create_run(with_run_dir(run, f"seed={seed}", f"algo.gamma={0.9 if method == 'good' else 0.99}"))
            write_episodes(run / "episodes.csv", episodes(ends))
            folders.append(f"{method}={run}")
    arguments = ["methods.py", str(tmp_path / "kept.json.gz"), "--window", "4", "--json", str(tmp_path / "told.json")]
    monkeypatch.setattr(sys, "argv", [*arguments, "--add", *folders[:5], "--add", *folders[5:], "--baseline", "poor"])
    methods.main()
    told = json.loads((tmp_path / "told.json").read_text())["good"]
    last, steps = told["measures"]["arrived, last"], told["measures"]["k steps to 80%"]
    assert (told["seeds"], last["iqm"], steps["iqm"]) == pytest.approx((5, 100.0, 0.1))
    assert last["difference"] == [75.0, 75.0, 75.0]
    assert "good against poor, arrived, last: +75.0 (+75.0 to +75.0)" in capsys.readouterr().out
    kept = json.loads(gzip.decompress((tmp_path / "kept.json.gz").read_bytes()))
    assert [run["settings"] for run in kept["poor"]] == [{}] * 5
    assert [run["settings"]["algo.gamma"] for run in kept["good"]] == [0.9] * 5
    monkeypatch.setattr(sys, "argv", [*arguments, "--flights", "5", "--plot", str(tmp_path / "curves.png")])
    methods.main()  # from the file alone
    assert "| good | 5 | 0.0 (0.0–0.0) | 0.0 (0.0–0.0) | never (never–never) | 100.0 (" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*arguments, "--flights", "3", "--plot", str(tmp_path / "curves.png")])
    with pytest.raises(UavrlError, match="flew 3 flights, fewer than --window 4"):
        methods.main()
    assert (tmp_path / "curves.png").stat().st_size > 5_000
    told = json.loads((tmp_path / "told.json").read_text())["good"]["measures"]
    assert told["arrived, last"]["iqm"] == 0.0 and told["k steps to 80%"]["iqm"] == float("inf")
    pool = ["--methods", "good", "--pool", "both=good", "--pool", "both=poor", "--baseline"]
    monkeypatch.setattr(sys, "argv", [*arguments, *pool, "both"])
    methods.main()
    told = json.loads((tmp_path / "told.json").read_text())
    assert list(told) == ["good", "both"] and told["both"]["seeds"] == 10
    assert told["good"]["measures"]["arrived, last"]["difference"][0] == pytest.approx(100 - 62.5)
    for wrong in ([*pool, "neither"], ["--methods", "neither"], ["--pool", "both=neither"]):
        monkeypatch.setattr(sys, "argv", [*arguments, *wrong])
        with pytest.raises(UavrlError, match=r"good; .*, got 'neither'"):
            methods.main()
    for wrong in ("good=poor", "good"):
        monkeypatch.setattr(sys, "argv", [*arguments, "--pool", wrong])
        with pytest.raises(UavrlError, match=f"Expected NAME=METHOD .*, got '{wrong}'"):
            methods.main()


def test_few_seeds_are_told_one_by_one_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import methods

    seeds = [methods.Flights(np.full(4, 250), np.array(list(ends))) for ends in ("aaaa", "cccc", "ccaa")]
    asked = SimpleNamespace(window=2, success=0.8, baseline=None)
    few, many = (methods.table(methods.told({"ours": runs}, asked), None) for runs in (seeds, [*seeds, *seeds[1:]]))
    assert "| ours | 3 | 100.0, 0.0, 100.0 | 100.0, 0.0, 50.0 | 0.5, never, 1.0 |" in few
    assert "250.0, –, 250.0 |" in few
    assert "| ours | 5 | 66.7 (0.0–100.0) | 33.3 (0.0–100.0) | 1.0 (0.5–never) |" in many


def test_a_run_that_was_stopped_is_kept_with_the_commit_that_flew_it(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import methods

    (run_dir / "summary.json").unlink()
    assert methods.read(run_dir)["commit"] == commit()


def test_differences_are_told_of_what_evaluations_wrote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Newcombe's own example (1998), method 10, flown as two halves; five equal trainings."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import differences

    rates = {"one": (28, 35), "other": (24, 40), "one, hidden": (35, 35)}
    kept = {name: {"episodes": total, "success": wilson(count, total)} for name, (count, total) in rates.items()}
    file = tmp_path / "policy: best.json"
    file.write_text(json.dumps(kept))

    def run(these: list[str], less: list[str]) -> str:
        repeated = [word for world in less for word in ("--less", f"{file}:{world}")]
        arguments = [*(f"{file}:{world}" for world in these), *repeated]
        monkeypatch.setattr(sys, "argv", ["differences.py", *arguments])
        differences.main()
        return capsys.readouterr().out

    told = run(["one", "one"], ["other", "other"])
    assert "80.0% (69.2% to 87.7%) of 70 tasks, trainings: 2" in told and "over trainings" not in told
    assert "difference +20.0 points (+5.2 to +33.4)" in told
    assert "over trainings +40.0 points (+40.0 to +40.0)" in run(["one, hidden"] * 5, ["other"] * 6)
    assert "over trainings" not in run(["one"] * 5, ["other"] * 4)
    with pytest.raises(UavrlError, match="got 'two': it tells of one; other; one, hidden"):
        run(["two"], ["other"])
    file.write_text("{")
    with pytest.raises(UavrlError, match=r"Expected FILE\.json:WORLD"):
        run(["one"], ["other"])


def test_dense_flights_are_told_of_the_odd_valleys_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two seeds of a method: in the dense valley all arrive at first and none later, elsewhere the other way round."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import dense_flights

    for seed in (0, 1):
        run = tmp_path / f"seed={seed}"
        run.mkdir()
        flown = episodes("ac" * 20 + "ca" * 20)
        write_episodes(run / "episodes.csv", [replace(each, world_seed=1 - i % 2) for i, each in enumerate(flown)])
    kept, picture = tmp_path / "kept.csv.gz", tmp_path / "picture.png"
    added = [f"mine, weight=1 s{seed}={tmp_path / f'seed={seed}'}" for seed in (0, 1)]
    arguments = ["dense_flights.py", str(kept), "--ranges", "0-400", "400-800", "790-800", "--window", "3"]
    monkeypatch.setattr(sys, "argv", [*arguments, "--add", *added, *added, "--add", f"cells2={tmp_path / 'seed=0'}"])
    dense_flights.main()
    assert "| mine, weight=1 | 2 | 100 % (91–100) of 40 | 0 % (0–9) of 40 | – |" in (told := capsys.readouterr().out)
    assert "| cells2 | 1 | 100 % (84–100) of 20 |" in told
    monkeypatch.setattr(sys, "argv", [*arguments, "--plot", str(picture)])  # from the file alone
    dense_flights.main()
    monkeypatch.setattr(sys, "argv", [*arguments, "--add", f"mine={tmp_path / 'none'}"])
    with pytest.raises(UavrlError, match="Expected NAME=FOLDER with a folder that exists, got 'mine="):
        dense_flights.main()
    assert "of 40 | 0 %" in capsys.readouterr().out and picture.stat().st_size > 5_000


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


def test_a_plane_passes_when_and_where_its_line_and_the_vehicles_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Head on and 1 m to the left of a vehicle that looks along y, so that what is at -x is on its left."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    from passes import ahead, passes

    time, miss = passes(np.array([[-1.0, 5.0, 0.5]]), np.array([[0.0, -5.0, 0.0]]))
    np.testing.assert_allclose(time, [1.0])
    np.testing.assert_allclose(ahead(miss, np.array([np.pi / 2])), [[0.0, 1.0, 0.5]], atol=1e-9)
    both = ahead(np.array([[[0.0, 1.0, 2.0], [1.0, 0.0, 0.0]]]), np.array([np.pi / 2]))
    np.testing.assert_allclose(both, [[[1.0, 0.0, 2.0], [0.0, -1.0, 0.0]]], atol=1e-9)


@pytest.mark.parametrize(
    ("known", "ahead", "beside", "dodges"),
    [
        ("all, straight on", 6.0, 0.0, True),
        ("all, straight on", 6.0, 6.0, False),
        ("in view, straight on", 6.0, 0.0, True),
        ("in view, straight on", 10.5, 0.0, False),
        ("all, straight on", 10.5, 0.0, True),
        ("all, as they will fly", 6.0, 0.0, False),  # it will turn back
    ],
)
def test_a_rule_that_is_told_of_a_plane_gets_out_of_its_way(
    known: str, ahead: float, beside: float, dodges: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plane comes on at 4 m/s, ``ahead`` and ``beside`` of a UAV whose nose points to the side of the world."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import told_of_planes as told
    from tensordict import TensorDict

    start = np.array([-beside, ahead, 3.5, 0.0])
    seconds = np.arange(1, 21)[:, None, None] / 10
    way = np.array([0.0, -4.0, 0.0, 0.0]) * seconds
    later = start + (np.where(seconds < 0.15, way, 10.0 - way) if known == "all, as they will fly" else way)
    env = SimpleNamespace(
        plane_poses=lambda: start[None],
        plane_paths=lambda steps: later[:steps],
        simulation=SimpleNamespace(yaw=np.array([np.pi / 2])),
    )
    state = {"faces": torch.zeros(1, 72), "heading_deg": torch.zeros(1, 1), "altitude": torch.full((1, 1), 3.5)}
    state |= {"position": torch.tensor([[0.0, 0.0, 3.5]]), "velocity": torch.tensor([[0.0, 2.0, 0.0]])}
    action = told.ToldOfPlanes(env, known)(TensorDict(state, [1]))["action"][0]  # type: ignore[arg-type]
    assert (action[0].item() < 1.99) == dodges


@pytest.mark.parametrize(
    ("position", "way"),
    [((1.5, 0.0, 3.6), 1), ((1.5, 0.0, 3.3), -1), ((1.5, 3.0, 3.5), 0), ((-2.0, 0.0, 3.5), 0), ((1.5, 0.0, 4.5), -1)],
)
def test_the_reflex_leaves_the_height_of_a_plane_that_comes_on(
    position: tuple[float, float, float], way: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Above its middle it climbs, below it dives, beside and behind it does nothing, under the ceiling it dives."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import planes

    mesh = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-1.0, 1.0) for z in (-0.25, 0.25)])
    pose = np.array([0.0, 0.0, 4.6 if position[2] == 4.5 else 3.5, 0.0])
    assert planes.climbs_or_dives(np.array(position), pose, mesh, 4.0) == way


def test_points_on_planes_are_those_that_a_scan_without_planes_has_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    from passes import on_planes

    nothing, rock = [np.nan] * 3, [5.0, 0.0, 0.0]
    without = np.array([[rock, nothing, rock], [rock, nothing, rock]])
    points = np.array([[[1.0, 2.0, 0.0], [3.0, 4.0, 0.0], rock], [rock, nothing, rock]])
    np.testing.assert_allclose(on_planes(points, without), [[2.0, 3.0, 0.0, 1.0, 2.0, 0.0, 0.02], [0.0] * 7])


def test_the_setting_that_solves_most_is_left_and_flown_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A world in which the patient one arrives: the fifth of sixteen, 4 tasks, then 16 and 64."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import tune_vfh

    present = asdict(tune_vfh.COSTS["range_image", "proximity"])
    settings = tune_vfh.drawn(16, present)
    assert settings[0] == present and settings == tune_vfh.drawn(16, present)
    for setting in settings[1:]:
        assert all(low <= setting[key] <= high for key, (low, high) in tune_vfh.RANGES.items())
    flown: list[int] = []

    def fly(env: Any, policy: Any, tasks: int) -> list[Any]:
        flown.append(tasks)
        outcome = "arrived" if policy.costs.caution == settings[4]["caution"] else "collided"
        return [SimpleNamespace(outcome=outcome)] * tasks

    monkeypatch.setattr(tune_vfh, "fly", fly)
    monkeypatch.setattr(tune_vfh, "make_env", lambda *parts, **more: SimpleNamespace(set_seed=lambda seed: None))
    monkeypatch.setattr(
        sys,
        "argv",
        f"tune_vfh.py perception.reduction=range_image --settings 16 --tasks 4 --json {tmp_path}/t.json".split(),
    )
    tune_vfh.main()
    told = json.loads((tmp_path / "t.json").read_text())
    rounds = told["rounds"]
    assert told["perception"] == ["range_image", "proximity"]
    assert [len(found) for found in rounds] == [16, 4, 1]
    assert rounds[2][0]["setting"] == settings[4] and rounds[2][0]["rate"] == 1.0
    assert flown == [2] * 32 + [8] * 8 + [32] * 2  # half of the tasks in each of the two worlds
    assert "100.0 %" in capsys.readouterr().out


def test_a_model_of_workers_grows_until_the_learner_is_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step of flying of 4 ms and an update of 2 ms: 166.7 steps a second in turn with one update, 222.2 with ¼."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import workers

    model = workers.modelled({"sync": {1.0: 1 / 6e-3, 0.25: 1 / 4.5e-3}})
    assert (model["flying"], model["update"]) == (pytest.approx(4e-3), pytest.approx(2e-3))
    assert model["rates"]["1.0"]["1"] == pytest.approx(250)  # who flies is the bound
    assert model["rates"]["1.0"]["2"] == model["rates"]["1.0"]["16"] == pytest.approx(500)  # the learner is
    assert model["rates"]["0.25"]["16"] == pytest.approx(2000)


def test_warnings_are_counted_backwards_from_the_collision(monkeypatch: pytest.MonkeyPatch) -> None:
    """c is what the state says: of two collisions one is warned of two steps ahead, one not at all."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import warning_time
    from tensordict import TensorDict

    def flight(said: list[float], end: str) -> TensorDict:
        last = torch.arange(len(said))[:, None] == len(said) - 1
        after = {key: last & (key == end) for key in ("collided", "arrived")}
        return TensorDict({"said": torch.tensor(said), "next": after}, [len(said)])

    told = SimpleNamespace(classifier=lambda said: said.logit(), _features=lambda flight: flight["said"])
    flights = [
        flight([0.1, 0.9, 0.2, 0.9, 0.9, 0.9], "collided"),
        flight([0.1] * 16, "collided"),
        flight([0.5] * 99, "arrived"),
    ]
    shares, first = warning_time.warnings(told, flights)
    assert shares[:6] == [0.5, 0.5, 0.5, 0.0, 0.5, 0.0]
    assert first == 1.5  # the median of 3 and 0
