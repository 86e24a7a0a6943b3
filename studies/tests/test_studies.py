"""Each study runs, in small, and answers from the kept files what the documentation quotes."""

from __future__ import annotations

import importlib
import itertools
import json
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict

from tests.helpers.commands import TINY, VALLEY, in_process
from tests.helpers.configs import with_run_dir
from tests.helpers.folders import episodes, evaluation, write_episodes
from uavrl.buffers import backward_reward
from uavrl.cli.export import main as export
from uavrl.cli.train import main as train
from uavrl.envs.sensors import SENSORS
from uavrl.errors import UavrlError
from uavrl.runs.provenance import commit
from uavrl.training.run import create_run

ROOT = Path(__file__).resolve().parents[2]
STUDIES, DATA = ROOT / "studies", ROOT / "docs/data"
Said = Callable[..., str]


def test_the_list_names_each_study_and_a_commit() -> None:
    listed = re.findall(
        r"^\| `(\w+)\.py` \| \S.*\? \| \S.* \| `[0-9a-f]{7}` \|$", (STUDIES / "README.md").read_text(), re.M
    )
    assert {*listed, "passes", "pictures", "run_statistics"} == {path.stem for path in STUDIES.glob("*.py")}


def test_variants_of_the_controller_are_flown_in_both_worlds(said: Said, tmp_path: Path) -> None:
    told = said("turning", "--tasks", 1, "--valleys", 1, "--only", 0, 4, "--json", tmp_path / "turning.json")
    found = json.loads((tmp_path / "turning.json").read_text())
    assert len(told.splitlines()) == 2 + 4 and len(found) == 2
    fast, today = ([world["action_change"][3] for world in worlds.values()] for worlds in found.values())
    assert fast > today  # the constants of the first are those of before


def test_an_exported_policy_flies_by_packets_and_mavlink(said: Said, tmp_path: Path) -> None:
    folder, file = tmp_path / "best", tmp_path / "found.json"
    assert in_process(export, "policy=best", f"output={folder}") == 0
    told = said("over_mavlink", folder, "--tasks", 1, "--guards", "map", "evasion", "--json", file, "--world", *VALLEY)
    found = json.loads(file.read_text())
    assert (found["guards"], len(found["outcomes"])) == (["map", "evasion"], 1)
    assert f"task 0: {found['outcomes']} after" in told


def test_failures_are_named_by_their_kind(said: Said, tmp_path: Path) -> None:
    study = runpy.run_path(str(STUDIES / "failure_kinds.py"))

    def steps(
        xs: Sequence[float], distance: float = 9.0, in_view: Sequence[bool] = (True,), steep: Sequence[bool] = (False,)
    ) -> list[Any]:
        seen, dives = itertools.cycle(in_view), itertools.cycle(steep)
        told = [(np.array([9.0, distance]), np.array([1, next(seen)]), np.array([1, next(dives)])) for _ in xs]
        return [study["Step"](np.array([x, 0.0, 3.0]), *each) for x, each in zip(xs, told, strict=True)]

    kind, along = study["kind"], np.arange(50) / 10
    assert kind("timed_out", steps(along)) == "time-out, on its way"
    assert kind("timed_out", steps(along / 2)) == "time-out, within 3 m"
    assert kind("collided", steps(along)) == "obstacle"
    assert kind("collided", [study["Step"](np.zeros(3), np.zeros(0), *np.zeros((2, 0), bool))]) == "obstacle"
    assert kind("collided", steps(along, 1.2)) == "plane that flies level, in view for three scans or more"
    hardly = [*[False] * 46, True, True, False, True]  # the last one is when they touch
    assert kind("collided", steps(along, 1.2, hardly)) == "plane that flies level, hardly ever in view"
    before, lately = ([*[False] * n, True, *[False] * (49 - n)] for n in (29, 30))
    assert kind("collided", steps(along, 1.2, steep=before)).startswith("plane that flies level")
    assert kind("collided", steps(along, 1.2, steep=lately)).startswith("plane that dives or climbs")

    file = tmp_path / "found.json"
    told = said("failure_kinds", "busy", "--guards", "none", "--episodes", 2, "--vehicles", 2, "--output", file)
    found = json.loads(file.read_text())["rows"]["busy"]
    assert told.splitlines()[0] == f"busy: {len(found)} failures of 2 tasks" and set(found) <= {"0", "1"}


# ---------------------------------------------------------------------- statistics of runs


def test_the_page_on_the_thesis_has_what_the_kept_runs_say(said: Said, tmp_path: Path) -> None:
    shown, picture, page = ROOT / "docs/thesis.md", tmp_path / "thesis.png", tmp_path / "thesis.md"
    emptied = re.sub(r"(: studies/thesis\.py -->\n)[^<]*", r"\1", shown.read_text(encoding="utf-8"))
    page.write_text(emptied, encoding="utf-8")
    said("thesis", "--page", page, "--plot", picture)
    assert page.read_text(encoding="utf-8") == shown.read_text(encoding="utf-8") != emptied
    assert picture.stat().st_size > 5_000


def test_the_policies_of_all_teachers_are_drawn(said: Said, tmp_path: Path) -> None:
    said("teachers", tmp_path / "teachers.png")
    assert (tmp_path / "teachers.png").stat().st_size > 5_000


def test_methods_are_compared_by_the_kept_runs(said: Said, tmp_path: Path) -> None:
    file = DATA / "methods/backward.json.gz"
    picture, chosen = tmp_path / "curves.png", ["--methods", "default reward", "ABR, centred", "IRCR"]
    told = said(
        "methods", file, *chosen, "--window", 200, "--steps", 105_000, "--baseline", "default reward", "--plot", picture
    )
    assert "| default reward | 5 | 83.3 (74.5–89.0) |" in told
    assert "ABR, centred against default reward, arrived, last: -2.3 (-11.7 to +7.0)" in told
    assert "IRCR against default reward, arrived, last: -4.8 (-11.5 to +6.8)" in told
    assert picture.stat().st_size > 5_000


def test_runs_are_put_into_a_file_and_pooled(said: Said, tmp_path: Path, run_dir: Path) -> None:
    """Flights of ten steps; the better method's last four arrive, of the other's the last alone."""
    folders = [f"stopped={run_dir}"]
    (run_dir / "summary.json").unlink()
    for method, ends in (("good", "ccccctaaaa"), ("poor", "ccccccctta")):
        for seed in range(5):
            run = tmp_path / f"{method}{seed}"
            create_run(with_run_dir(run, f"seed={seed}", f"algo.gamma={0.9 if method == 'good' else 0.99}"))
            write_episodes(run / "episodes.csv", episodes(ends))
            folders.append(f"{method}={run}")
    file, numbers = tmp_path / "kept.json", tmp_path / "told.json"
    rows = ["--methods", "good", "--pool", "both=good", "--pool", "both=poor", "--baseline", "both", "--json", numbers]
    assert "| both | 10 |" in said("methods", file, "--add", *folders, "--window", 4, *rows)
    kept, told = json.loads(file.read_text()), json.loads(numbers.read_text())
    assert [run["settings"] for run in kept["poor"]] == [{}] * 5 and kept["good"][0]["settings"] == {"algo.gamma": 0.9}
    assert kept["stopped"][0]["commit"] == commit()
    assert told["good"]["measures"]["arrived, last"]["iqm"] == 100.0
    assert told["good"]["measures"]["k steps to 80%"]["iqm"] == pytest.approx(0.1)
    assert told["good"]["measures"]["arrived, last"]["difference"][0] == pytest.approx(100 - 62.5)
    assert "| good | 5 | 0.0 (0.0–0.0) |" in said("methods", file, "--methods", "good", "--window", 4, "--flights", 5)
    with pytest.raises(SystemExit):
        said("methods", file, "--methods", "neither")


def test_differences_of_evaluations(said: Said, capsys: pytest.CaptureFixture[str]) -> None:
    ours, less = (
        [f"best{name}" for name in ("_seed0", "_seed1", "", "_seed3", "_seed4")],
        [f"weight04_seed{i}" for i in range(5)],
    )
    sides = [[f"{DATA}/suite/{name}.json:dense" for name in side] for side in (ours, less)]
    assert "over trainings +7.7 points (+0.5 to +12.0)" in said("differences", *sides[0], "--less", *sides[1])
    told = said("differences", f"{DATA}/suite/best_seed0.json:static", "--less", *sides[1][:4])
    assert ", 500 tasks), trainings: 1" in told and "over trainings" not in told
    rates = ({"rate": 0.8, "low": 0.69183, "high": 0.87695}, {"rate": 0.6, "low": 0.49045, "high": 0.70038})
    newcombe = importlib.import_module("run_statistics").difference_of_rates(*rates)
    assert newcombe == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)  # 56 of 70 against 48 of 80, in his Table II
    with pytest.raises(SystemExit):
        said("differences", "none.json:a", "--less", "none.json:b")
    assert capsys.readouterr().err.startswith("uavrl: Expected FILE.json:WORLD")


@pytest.mark.parametrize(
    ("cells", "interval"),
    [
        ((36, 12, 2, 0), (20.0, 5.69, 34.04)),
        ((1, 1, 7, 12), (-28.57, -50.69, -2.56)),
        ((54, 0, 0, 0), (0, -6.64, 6.64)),
    ],
)
def test_paired_differences_are_newcombes(
    said: Said, cells: tuple[int, int, int, int], interval: tuple[float, float, float]
) -> None:
    """Both, one alone, the other alone, neither: first as in his paper, then as in Fagerland et al. (2013)."""
    ours, theirs = ("".join(a * n for a, n in zip(ends, cells, strict=True)) for ends in ("SSCC", "SCSC"))
    found = importlib.import_module("run_statistics").paired_difference(ours, theirs)
    assert found == pytest.approx(interval, abs=6e-3)


def test_two_evaluations_are_compared_task_by_task(said: Said, tmp_path: Path) -> None:
    """Of six tasks one success is lost and two are won; a time-out in a collision's place changes no success."""
    import outcomes

    one = evaluation(tmp_path, 3, 6, "one.json", outcomes="SSCTSC")
    ends = {"S": "arrived", "C": "collided", "T": "timed_out"}
    flights = [{"task": task, "outcome": ends[letter]} for task, letter in enumerate("CSSSST")]
    other = evaluation(tmp_path, 4, 6, "other.json", flights=flights)
    (tmp_path / "suite.json").write_text(json.dumps({"static": json.loads(other.read_text())}))
    assert "66.7 % of the outcomes differ: 1 successes lost, 2 won" in said(
        "outcomes", one, f"{tmp_path}/suite.json:static"
    )
    with pytest.raises(UavrlError, match="same tasks, they differ by seed"):
        outcomes.compared(outcomes.evaluation(str(one)), {**outcomes.evaluation(str(one)), "seed": 1})
    among = {**outcomes.evaluation(str(one)), "planes": 3, "num_uavs": 8}
    assert outcomes.compared(among, {**among, "processes": 1})["changed"] == 0
    with pytest.raises(UavrlError, match="same tasks, they differ by num_uavs and processes"):
        outcomes.compared(among, {**among, "num_uavs": 4, "processes": 2})


def test_dense_flights_are_told_of_the_odd_valleys_alone(said: Said, tmp_path: Path) -> None:
    """Two seeds: in the dense valley all arrive at first and none later, elsewhere the other way round."""
    told = said("dense_flights", DATA / "guided/near.csv.gz", "--plot", tmp_path / "near.png")
    assert "| preset best | 5 | 81.1 (76.2–85.2) of 286 | 83.1 (79.0–86.5) of 384 |" in told
    added = [f"mine, weight=1 s{seed}={tmp_path / f'seed={seed}'}" for seed in (0, 1)]
    for seed in (0, 1):
        (run := tmp_path / f"seed={seed}").mkdir()
        flown = episodes("ac" * 20 + "ca" * 20)
        write_episodes(run / "episodes.csv", [replace(each, world_seed=1 - i % 2) for i, each in enumerate(flown)])
    told = said(
        "dense_flights", tmp_path / "kept.csv.gz", "--add", *added, *added, "--ranges", "0-400", "400-800", "790-800"
    )
    assert "| mine, weight=1 | 2 | 100.0 (91.2–100.0) of 40 | 0.0 (0.0–8.8) of 40 | – |" in told


def test_learning_curves_are_drawn_beside_references(said: Said, finished: Path, tmp_path: Path) -> None:
    alone, beside = tmp_path / "alone.png", tmp_path / "beside.png"
    assert "episodes" in said("learning_curves", finished, "--window", 2, "--output", alone)
    said("learning_curves", finished, "--window", 2, "--reference", DATA / "bipedal/reference.json", "--output", beside)
    assert alone.stat().st_size > 5_000 < beside.stat().st_size
    (tmp_path / "wrong.json").write_text('{"td3": {"returns": [1.0]}}')
    with pytest.raises(SystemExit):
        said("learning_curves", finished, "--reference", tmp_path / "wrong.json")


# ---------------------------------------------------------------------- planes


def test_the_reflex_flies_beside_a_policy_without(said: Said, tmp_path: Path) -> None:
    small = ["env.world.obstacles=8", "env.max_steps=5"]
    told = said("planes", "--episodes", 2, *small, "--json", tmp_path / "planes.json")
    assert "sees no plane" in told and "with the reflex" in told
    assert json.loads((tmp_path / "planes.json").read_text())["with the reflex"]["rate"] == 0.0


@pytest.mark.parametrize(
    ("position", "way"),
    [((1.5, 0.0, 3.6), 1), ((1.5, 0.0, 3.3), -1), ((1.5, 3.0, 3.5), 0), ((-2.0, 0.0, 3.5), 0), ((1.5, 0.0, 4.5), -1)],
)
def test_the_reflex_leaves_the_height_of_a_plane_that_comes_on(
    position: tuple[float, float, float], way: int, said: Said
) -> None:
    """Above its middle it climbs, below it dives, beside and behind it does nothing, under the ceiling it dives."""
    import planes

    mesh = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-1.0, 1.0) for z in (-0.25, 0.25)])
    pose = np.array([0.0, 0.0, 4.6 if position[2] == 4.5 else 3.5, 0.0])
    assert planes.climbs_or_dives(np.array(position), pose, mesh, 4.0) == way


def test_a_rule_flies_with_all_that_it_is_told(said: Said) -> None:
    told = said("told_of_planes", "--tasks", 1, "env.world.obstacles=5", "env.max_steps=3")
    assert told.count("| 0.0 (0.0–79.3) | 0 | 1 |") == 5


def test_reactions_are_told_by_the_time_that_is_left(said: Said) -> None:
    told = said("reactions", "--steps", 45, "env.world.planes=6", "env.world.obstacles=8")
    assert re.search(r"^\d\.\d\d to \d\.\d s +\d+( +[+-]\d\.\d\d){3}$", told, re.M)


@pytest.mark.filterwarnings("ignore:Mean of empty slice", "ignore:invalid value")
def test_foresight_tells_of_each_input(said: Said) -> None:
    told = said("foresight", "--steps", 45, "env.world.obstacles=8")
    assert told.count("left or right") == told.count("above or below") == 4


def test_a_plane_passes_when_and_where_its_line_and_the_vehicles_say(said: Said) -> None:
    """Head on and 1 m to the left of a vehicle that looks along y; points on planes are those that are new."""
    from passes import ahead, on_planes, passes

    time, miss = passes(np.array([[-1.0, 5.0, 0.5]]), np.array([[0.0, -5.0, 0.0]]))
    np.testing.assert_allclose(time, [1.0])
    np.testing.assert_allclose(ahead(miss, np.array([np.pi / 2])), [[0.0, 1.0, 0.5]], atol=1e-9)
    nothing, rock = [np.nan] * 3, [5.0, 0.0, 0.0]
    without = np.array([[rock, nothing, rock], [rock, nothing, rock]])
    points = np.array([[[1.0, 2.0, 0.0], [3.0, 4.0, 0.0], rock], [rock, nothing, rock]])
    np.testing.assert_allclose(on_planes(points, without), [[2.0, 3.0, 0.0, 1.0, 2.0, 0.0, 0.02], [0.0] * 7])


# ---------------------------------------------------------------------- rules, LifeGuard, FORK


def test_the_setting_that_solves_most_is_left_and_flown_most(
    said: Said, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A world in which the patient one arrives: the fifth of sixteen, 4 tasks, then 16 and 64."""
    import tune_vfh

    settings = tune_vfh.drawn(16, asdict(tune_vfh.COSTS["range_image", "proximity"]))
    flown: list[int] = []

    def fly(env: Any, policy: Any, tasks: int) -> list[Any]:
        flown.append(tasks)
        outcome = "arrived" if policy.costs.caution == settings[4]["caution"] else "collided"
        return [SimpleNamespace(outcome=outcome)] * tasks

    monkeypatch.setattr(tune_vfh, "rollout_episodes", fly)
    monkeypatch.setattr(tune_vfh, "make_env", lambda *parts, **more: SimpleNamespace(set_seed=lambda seed: None))
    arguments = f"tune_vfh.py perception=range_image --settings 16 --tasks 4 --json {tmp_path}/t.json"
    monkeypatch.setattr(sys, "argv", arguments.split())
    tune_vfh.main()
    rounds = json.loads((tmp_path / "t.json").read_text())["rounds"]
    assert [len(found) for found in rounds] == [16, 4, 1]
    assert rounds[2][0]["setting"] == settings[4] and rounds[2][0]["rate"] == 1.0
    assert flown == [2] * 32 + [8] * 8 + [32] * 2  # half of the tasks in each of the two worlds


def test_warnings_are_counted_backwards_from_the_collision(said: Said) -> None:
    """c is what the state says: of two collisions one is warned of two steps ahead, one not at all."""
    import warning_time

    def flight(said: list[float], end: str) -> TensorDict:
        last = torch.arange(len(said))[:, None] == len(said) - 1
        after = {key: last & (key == end) for key in ("collided", "arrived")}
        return TensorDict({"said": torch.tensor(said), "next": after}, [len(said)])

    told: Any = SimpleNamespace(classifier=lambda said: said.logit(), _features=lambda flight: flight["said"])
    flights = [
        flight([0.1, 0.9, 0.2, 0.9, 0.9, 0.9], "collided"),
        flight([0.1] * 16, "collided"),
        flight([0.5] * 99, "arrived"),
    ]
    shares, first = warning_time.warnings(told, flights)  # type: ignore[arg-type]
    assert shares[:6] == [0.5, 0.5, 0.5, 0.0, 0.5, 0.0]
    assert first == 1.5  # the median of 3 and 0


def test_a_classifier_learns_to_warn_from_flights(said: Said) -> None:
    told = said("warning_time", "--flights", 24, "--forms", "linear (the thesis)")
    assert re.search(r"taught with 16 flights; asked in \d that collided and \d that arrived", told)
    assert "linear (the thesis)" in told


def test_lifeguards_directions_are_compared_with_the_truth(said: Said, tmp_path: Path) -> None:
    told = said("lifeguard_gradients", "--output", tmp_path / "arrows.png")
    assert "linear: smallest cosine between any two of its directions 1.00" in told
    assert (tmp_path / "arrows.png").stat().st_size > 5_000


def test_forks_threshold_is_measured_on_a_run(said: Said, finished: Path) -> None:
    told = said("fork_threshold", finished, "--updates", 20)
    assert "system loss of predicting no change: 0." in told and "20 updates: system loss" in told


def test_saturation_is_told_of_each_action(said: Said, finished: Path) -> None:
    assert said("saturation", finished).count("mean ") == 4


# ---------------------------------------------------------------------- parts that lost


@pytest.fixture
def lost(monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(STUDIES / "lost_parts")
    return STUDIES / "lost_parts"


@pytest.mark.parametrize("rule", ["ircr", "abr_centred"])
def test_a_lost_rule_is_trained_with_through_the_open_door(rule: str, lost: Path, tmp_path: Path) -> None:
    door = ["--config-dir", str(lost / "conf"), "packages=[lost_parts]"]
    assert in_process(train, *door, *TINY, f"backward_reward={rule}", f"run_dir={tmp_path / 'run'}") == 0
    written = OmegaConf.load(tmp_path / "run/config.yaml")
    assert written.backward_reward["_target_"].startswith("lost_parts.")
    assert in_process(train, f"resume={tmp_path / 'run'}", door[2], "trainer.episodes=7") == 0


def test_centred_pays_the_place_among_the_last_sums(lost: Path) -> None:
    """Sums 3, 6, 0 and 3 of one class: 0, 1/2, -2/3, 0; what comes over and over is in the middle."""
    from lost_parts.centred import CentredABR, RecentSums

    assert CentredABR(window=7).history.window == 7
    raw = torch.tensor([1.0] * 3 + [2.0] * 3 + [0.0] * 3 + [1.0] * 3)
    new = backward_reward(raw, torch.zeros(4, dtype=torch.int64), RecentSums(), multiplier=1.0)
    torch.testing.assert_close(new - raw, torch.tensor([0.0, 0.5, -2 / 3, 0.0]).repeat_interleave(3))
    recent, other = RecentSums(window=100), RecentSums(window=100)
    assert np.mean([recent.insert_and_rank(0, k % 50) for k in range(2000)][1000:]) == pytest.approx(0.0, abs=0.02)
    other.load_state_dict(recent.state_dict())
    assert other.values(0) == recent.values(0) and other.insert_and_rank(0, 7.5) == recent.insert_and_rank(0, 7.5)


def test_ircr_pays_every_step_of_a_flight_that_arrived_and_goes_on_from_a_checkpoint(lost: Path) -> None:
    from lost_parts.ircr import IRCR

    done, lost_flight = torch.tensor([False, True]), torch.zeros(2, dtype=torch.bool)
    rule, other = IRCR(multiplier=2.0), IRCR(multiplier=2.0)
    rule.relabel(torch.zeros(2, 1), torch.tensor([3.0, 1.0]), lost_flight, done)  # paid nothing, the highest return
    rule.relabel(torch.zeros(2, 1), torch.tensor([0.0, 0.0]), done, done)
    other.load_state_dict(rule.state_dict())
    paid = other.relabel(torch.zeros(2, 1), torch.tensor([1.0, 0.0]), done, done)
    assert paid.tolist() == [1.5, 0.5]  # a quarter of the way, twice


# ---------------------------------------------------------------------- speed


def test_a_model_of_workers_grows_until_the_learner_is_busy(said: Said) -> None:
    """A step of flying of 4 ms and an update of 2 ms: 166.7 steps a second in turn with one update, 222.2 with ¼."""
    import workers

    model = workers.modelled({"sync": {1.0: 1 / 6e-3, 0.25: 1 / 4.5e-3}})
    assert (model["flying"], model["update"]) == (pytest.approx(4e-3), pytest.approx(2e-3))
    assert model["rates"]["1.0"]["1"] == pytest.approx(250)  # who flies is the bound
    assert model["rates"]["1.0"]["2"] == model["rates"]["1.0"]["16"] == pytest.approx(500)  # the learner is
    assert workers.wire()["weights"] > 100_000


def test_the_walkers_time_is_shared_out(tmp_path: Path) -> None:
    output = tmp_path / "numbers.json"
    command = [sys.executable, str(STUDIES / "walker_speed.py"), "trainer.execution=captured", "env.max_steps=100"]
    search = f"{ROOT / 'benchmarks'}:{ROOT / 'examples/walker'}:{ROOT}"
    subprocess.run(
        [*command, "--steps", "50", "--json", str(output)], check=True, cwd=tmp_path, env={"PYTHONPATH": search}
    )
    numbers = json.loads(output.read_text())
    assert sum(numbers["shares"].values()) == pytest.approx(1)
    assert {"updates", "environment"} < set(numbers["shares"])


def test_a_sequential_comparison_is_right_about_recorded_policies(said: Said) -> None:
    """A pair that differs by 30 points is told apart early; all recorded pairs, each in one order, seldom wrongly."""
    tally = importlib.import_module("sequential").tally
    better, worse = "S" * 450 + "C" * 50, "SSC" * 150 + "S" * 50
    assert tally([(better, worse)], ["first"], 25)[:4] == (1, 100.0, 0.0, 0.0)
    assert tally([(better, better)], [None], 25) == (1, 0.0, 0.0, 100.0, 500.0)
    rows = [
        line.strip("| ").split(" | ") for line in said("sequential", "--orders", 1, "--block", 250).splitlines()[2:]
    ]
    assert [row[0] for row in rows] == ["different", "too close to tell", "equal by a coin"]
    assert float(rows[0][3]) < 1.0 and float(rows[0][2]) > 60 and float(rows[2][3]) < 5.0


def test_a_policy_flies_with_sensors_that_it_was_not_trained_with(said: Said, tmp_path: Path) -> None:
    chosen = ("--worlds", "static", "--sensors", "rplidar", "--guards", "none")
    told = ("--episodes", 1, *chosen, "--output", tmp_path / "sensors.json")
    table = said("sensors", *told)
    assert re.search(r"^\| `static` \| `rplidar` \| none \| 48 \| (100|0)\.0 \(", table, re.M)
    (kept,) = json.loads((tmp_path / "sensors.json").read_text())
    assert (kept["policy"], kept["unseen_cells"], len(kept["outcomes"])) == ("best", 48, 1)
    assert said("sensors", *told) == table  # which it reads again


def test_no_phantom_moves_in_a_world_that_stands_still(said: Said) -> None:
    chosen = ("--worlds", "static", "--sensors", "mid360", "--vehicles", 1, "--steps", 6)
    assert "| `mid360` | 0 of 6 |" in said("phantom_motion", *chosen)


def test_the_mid360_lies_as_its_own_rays_do(said: Said, tmp_path: Path) -> None:
    """Every third ray hits nothing; the moment of the pattern is found."""
    rays = 3.0 * SENSORS["mid360"].rays.directions.reshape(-1, 3)[41_000:42_000].astype("<f4")
    rays[::3] = 0.0
    fields = [{"name": axis, "offset": 4 * number} for number, axis in enumerate("xyz")]
    message = {"fields": fields, "point_step": 12, "data": list(rays.tobytes())}
    (tmp_path / "scan.json").write_text(json.dumps(message))
    assert re.search(r"^\| scan\.json \| 666 \| 0\.00 \| ", said("mid360_pattern", tmp_path / "scan.json"), re.M)
