"""Built valleys are kept on disk, and nothing that happens to the disk changes a valley."""

from __future__ import annotations

import ast
import errno
import gc
import importlib
import inspect
import io
import logging
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.commands import in_process
from uavrl.cli import train as train_command
from uavrl.envs import place as place_module
from uavrl.envs import valley_cache
from uavrl.envs.place import Place, build_place
from uavrl.envs.rules import Scene
from uavrl.envs.world import World, WorldConfig, map_places
from uavrl.runs.cache import cache_folder, valley_folder

RULES = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0)


@pytest.fixture(scope="module", autouse=True)
def valleys_built_once() -> None:
    """Not here: the building is what these tests are about."""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("UAVRL_CACHE", str(tmp_path / "cache"))
    valley_cache._say_not_kept.cache_clear()
    return tmp_path / "cache" / "valleys"


@pytest.fixture
def mapped(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The seeds of the valleys that were mapped and not read."""
    seeds, compute = [], place_module._map_place

    def counted(config: WorldConfig, seed: int, *rest: object) -> valley_cache.ValleyMap:
        seeds.append(seed)
        return compute(config, seed, *rest)

    monkeypatch.setattr(place_module, "_map_place", counted)
    return seeds


def built(config: WorldConfig = RULES, seed: int = 3, count: int = 3) -> Place:
    return build_place(replace(config, seeds=(seed,), obstacles=count), 0, np.zeros(2))


def assert_same(one: Place, other: Place) -> None:
    np.testing.assert_array_equal(one.candidates, other.candidates)
    assert [lane.corners.tolist() for lane in one.lanes] == [lane.corners.tolist() for lane in other.lanes]
    assert [tasks.tolist() for tasks in one.trapped] == [tasks.tolist() for tasks in other.trapped]
    np.testing.assert_array_equal(one.fits, other.fits)
    assert one.corner.tolist() == other.corner.tolist()


@pytest.mark.parametrize(
    "config",
    [
        RULES,
        replace(RULES, planes=1, plane_wingspan=1.2),
        WorldConfig(size=(30.0, 26.0), obstacles=2, traps=1, min_goal_distance=5.0),
    ],
    ids=["plain", "planes", "traps"],
)
def test_a_valley_from_the_cache_is_the_same_to_the_last_bit(config: WorldConfig, mapped: list[int]) -> None:
    first, second = built(config), built(config)
    assert mapped == [3] and (len(first.lanes) > 0, len(first.trapped)) == (config.planes > 0, config.traps)
    assert_same(first, second)


def test_what_a_valley_depends_on_is_in_its_name(mapped: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    built()
    for other in ({"goal_radius": 2.0}, {"plane_speed": (2.0, 3.0)}, {"plane_wingspan": 0.5}, {"seeds": (1, 2)}):
        built(replace(RULES, **other))
    assert len(mapped) == 1, "these change nothing of it"
    others = [{name: getattr(RULES, name) * 0.9} for name in ("flight_level", "ceiling", "min_clearance", "uav_radius")]
    others += [{"size": (14.0, 13.0)}, {"obstacle_scale": 0.9}, {"min_goal_distance": 4.0}, {"planes": 1}]
    for n, other in enumerate(others, 2):
        built(replace(RULES, **other))
        assert len(mapped) == n, other
    built(seed=4)
    built(count=2)
    monkeypatch.setattr(valley_cache, "CODE", ["of another version"])
    built()
    assert len(mapped) == len(others) + 4


@dataclass
class Empty(WorldConfig):
    """The valley of somebody's own class, without obstacles."""

    def scene(self, number: int) -> Scene:
        return super().scene(number)._replace(obstacles=[])


def test_a_class_of_somebodys_own_shares_no_map_with_the_valley(mapped: list[int]) -> None:
    own = World(Empty(**vars(RULES))).places[0]
    plain = built()
    assert len(mapped) == 2 and len(plain.candidates) < len(own.candidates)
    assert_same(built(), plain)
    assert_same(World(Empty(**vars(RULES))).places[0], own)
    assert len(mapped) == 2, "each from its own map"


def test_the_code_that_is_hashed_is_there() -> None:
    assert len(valley_cache.CODE[0]) == 64
    named = {Path(sys.modules[f"uavrl.envs.{name}"].__file__ or "").stem for name in valley_cache._CODE}
    assert named == set(valley_cache._CODE)


def test_all_that_the_hashed_code_imports_is_hashed() -> None:
    """But what checks settings, names the default vehicle or tells of errors, and so changes no map."""
    known = {
        *(f"uavrl.envs.{name}" for name in valley_cache._CODE),
        *(f"uavrl_onboard.{n}" for n in valley_cache._ONBOARD),
    }
    harmless = {"uavrl.envs.limits", "uavrl.envs.scene_check", "uavrl.envs.valley_cache", "uavrl_onboard.vehicle"}
    harmless |= {"uavrl.errors", "uavrl_onboard.errors", "uavrl.runs.cache"}
    for name in sorted(known):
        tree = ast.parse(inspect.getsource(importlib.import_module(name)))
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        ours = {each for each in imported if each is not None and each.startswith("uavrl")}
        assert ours <= known | harmless, name


def archive(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def good(**changed: np.ndarray) -> bytes:
    nothing = {"lanes": np.zeros((0, 0, 3)), "trapped": np.zeros((0, 2), np.int64), "traps": np.zeros(0, np.int64)}
    level = {"fits": np.ones((3, 3), bool), "corner": np.zeros(2)}
    return archive(**{"candidates": np.ones((4, 2)), **nothing, **level, **changed})


def encrypted(content: bytes) -> bytes:
    """An archive whose entries say that they need a password."""
    local, central = b"PK\x03\x04", b"PK\x01\x02"
    for mark, flags in ((local, 6), (central, 8)):
        parts = content.split(mark)
        content = mark.join([parts[0], *(part[: flags - 4] + b"\x01" + part[flags - 3 :] for part in parts[1:])])
    return content


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a file of ours",
        good()[:-40],
        good()[:100],
        good().replace(b"candidates", b"candidatez"),
        good(candidates=np.array([[object(), 1.0]], dtype=object)),
        good(candidates=np.full((4, 2), np.nan)),
        good(candidates=np.zeros((0, 2))),
        good(candidates=np.ones((4, 3))),
        good(trapped=np.array([[0, 4]]), traps=np.array([1])),
        good(trapped=np.array([[0, 1]]), traps=np.array([2])),
        good(lanes=np.full((1, 6, 3), np.inf)),
        good(fits=np.zeros((3, 3), bool)),
        good(corner=np.array([np.nan, 0.0])),
        good().replace(b"(4, 2)", b"(9, 2)"),
        good().replace(b"(4, 2), }             ", b"(99999999999999, 2), }"),
        encrypted(good()),
    ],
    ids=[
        "empty",
        "text",
        "cut",
        "cut early",
        "names",
        "objects",
        "nan",
        "none",
        "shape",
        "index",
        "count",
        "infinite",
        "nowhere",
        "corner",
        "long",
        "huge",
        "encrypted",
    ],
)
def test_a_damaged_file_is_warned_of_and_replaced(
    content: bytes, folder: Path, mapped: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    whole = built()
    (file,) = folder.iterdir()
    file.write_bytes(content)
    again = built()
    assert len(mapped) == 2 and "is damaged" in caplog.text and str(file) in caplog.text
    assert_same(whole, again)
    assert_same(whole, built())
    assert len(mapped) == 2


def test_a_file_that_claims_to_be_huge_is_not_read(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    built()
    (file,) = folder.iterdir()
    with file.open("wb") as out:
        np.savez_compressed(out, candidates=np.zeros((valley_cache._MOST_ENTRY // 16 + 1, 2)))
    built()
    assert "it is larger than a valley" in caplog.text


def test_many_at_once_write_and_read_the_same_valley(folder: Path) -> None:
    made = built()
    name = next(folder.iterdir()).name
    kept = valley_cache.ValleyMap(made.candidates, made.lanes, made.trapped, made.fits, made.corner)

    def turn(n: int) -> bool:
        valley_cache.save_map(name, kept)
        found = valley_cache.load_map(name)
        return found is not None and np.array_equal(found.candidates, made.candidates)

    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(turn, range(64)))
    assert [path.name for path in folder.iterdir()] == [name], "no part of a file is left"


def raising(number: int) -> Callable[..., None]:
    def fail(file: io.BufferedWriter, **arrays: np.ndarray) -> None:
        file.write(b"begun")
        raise OSError(number, os.strerror(number))

    return fail


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_full_disk_stops_nobody_and_keeps_no_part(
    number: int, folder: Path, monkeypatch: pytest.MonkeyPatch, mapped: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(np, "savez_compressed", raising(number))
    assert_same(built(), built())
    assert len(mapped) == 2 and not list(folder.iterdir())
    assert caplog.text.count("cannot be kept") == 1 and os.strerror(number) in caplog.text


def test_a_folder_that_cannot_be_made_stops_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, mapped: list[int]
) -> None:
    caplog.set_level(logging.INFO)
    (tmp_path / "file").touch()
    monkeypatch.setenv("UAVRL_CACHE", str(tmp_path / "file" / "below"))
    map_places(RULES)
    assert not mapped, "in vain, for another process"
    assert len(World(RULES).places) == 1 and len(mapped) == 1
    assert caplog.text.count("cannot be kept") == 1 and "UAVRL_CACHE" in caplog.text


def test_the_least_recently_used_go_first(folder: Path) -> None:
    folder.mkdir(parents=True)
    names = [f"{letter * 40}.npz" for letter in "abcd"]
    for age, name in enumerate([*names, "somebody's.npz"]):
        (folder / name).write_bytes(bytes(100))
        os.utime(folder / name, (1000 - age, 1000 - age))
    valley_cache._make_room(folder, 250)
    assert sorted(path.name for path in folder.iterdir()) == [*names[:2], "somebody's.npz"], "which is not ours"
    built()
    (file,) = [path for path in folder.iterdir() if path.name not in (*names, "somebody's.npz")]
    os.utime(file, (1, 1))
    built()
    assert file.stat().st_mtime > 1000, "reading is using"


def test_the_limit_holds_when_a_valley_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir(parents=True)
    old = folder / f"{'a' * 40}.npz"
    old.write_bytes(bytes(valley_cache.MOST_BYTES))
    os.utime(old, (1, 1))
    built()
    assert len(list(folder.iterdir())) == 1 and not old.exists()


def test_valleys_are_mapped_for_another_process(mapped: list[int]) -> None:
    several = replace(RULES, seeds=(3, 4, 5), obstacles=(3, 2))
    map_places(several)
    assert sorted(mapped) == [3, 4, 5]
    map_places(several)
    world = World(several)
    assert len(mapped) == 3 and [len(valley.obstacles) for valley in world.places] == [3, 2, 3]


def test_help_says_where(capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(train_command.main, "--help") == 0
    assert str(valley_folder()) in capsys.readouterr().out


def test_the_folder_follows_the_xdg_specification(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("UAVRL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "uavrl"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative, which it says to ignore")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home/.cache/uavrl"


class Finalized:
    """Garbage that only the collector finds, whose end runs Python: another thread may go on there."""

    def __init__(self) -> None:
        self.itself = self

    def __del__(self) -> None:
        sum(range(20))


def test_threads_that_read_maps_side_by_side_do_not_disturb_each_other() -> None:
    """CPython counts the depth of a syntax tree, as which NumPy reads an array's header, for all threads together."""
    place = built()
    name = next(valley_folder().iterdir()).name

    def read(_: int) -> bool:
        Finalized()
        found = valley_cache.load_map(name)
        return found is not None and np.array_equal(found.candidates, place.candidates)

    before, interval = gc.get_threshold(), sys.getswitchinterval()
    gc.set_threshold(20)
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as threads:
            assert all(threads.map(read, range(500)))
    finally:
        gc.set_threshold(*before)
        sys.setswitchinterval(interval)
