"""Meshes and point clouds from files: any format gives the same place, and what is no place is told in a sentence."""

from __future__ import annotations

import json
import logging
import os
import re
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pypcd4 import PointCloud

from tests.helpers.valleys import NEAR
from uavrl.envs import file_worlds, shape_file, shape_reader
from uavrl.envs.file_worlds import CloudConfig, FileWorld, MeshConfig
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.shape_file import Surface, columns_along, floor_of, other_up, sampled
from uavrl.envs.voxels import occupied, voxel_mesh
from uavrl.envs.world import World
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh, signed_volume

SIZE = (16.0, 12.0)
SHORT = {"min_goal_distance": 5.0}


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))


@pytest.fixture(scope="module")
def site() -> trimesh.Trimesh:
    """A floor with two pillars, away from the file's origin."""
    parts = [box((*SIZE, 0.2), (100, 50, 9.9)), box((1, 1, 8), (98, 50, 14)), box((1, 2, 8), (103, 52, 14))]
    return trimesh.util.concatenate(parts)


@pytest.fixture(scope="module")
def points(site: trimesh.Trimesh) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(site, 60_000, seed=0)[0])


def write_mesh(site: trimesh.Trimesh, path: Path) -> Path:
    if path.suffix == ".glb":  # whose standard says that y is up
        site = site.copy().apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    site.export(path)
    return path


def write_cloud(points: np.ndarray, path: Path) -> Path:
    if path.suffix == ".pcd":
        missed = np.vstack([points, np.full((5, 3), np.nan)])
        PointCloud.from_xyz_points(missed.astype(np.float32)).save(path)
    elif path.suffix == ".npz":
        np.savez_compressed(path, points=points, colours=np.zeros(3))
    elif path.suffix == ".npy":
        np.save(path, points)
    elif path.suffix == ".xyz":
        np.savetxt(path, points)
    else:
        trimesh.PointCloud(points).export(path)
    return path


@pytest.mark.parametrize("suffix", shape_reader.MESHES)
def test_any_mesh_file_gives_the_same_place(suffix: str, site: trimesh.Trimesh, tmp_path: Path) -> None:
    scene = MeshConfig(file=str(write_mesh(site, tmp_path / f"site{suffix}"))).scene(0)
    (solid,) = scene.obstacles
    assert sorted(scene.size) == pytest.approx(sorted(SIZE), abs=1e-4) and len(solid.mesh.faces) == 36
    low, high = solid.mesh.vertices.min(0), solid.mesh.vertices.max(0)
    np.testing.assert_allclose(sorted(high[:2]), [6, 8], atol=1e-4)
    np.testing.assert_allclose([low[2], high[2]], [-0.2, 8.0], atol=1e-4)  # the slab's top is the ground


@pytest.mark.parametrize("suffix", shape_reader.CLOUDS)
def test_any_cloud_file_gives_the_same_place(suffix: str, points: np.ndarray, tmp_path: Path) -> None:
    config = CloudConfig(file=str(write_cloud(points + 0.013, tmp_path / f"scan{suffix}")), voxel=0.25, min_points=1)
    scene = config.scene(0)
    (solid,) = scene.obstacles
    assert scene.size == pytest.approx(SIZE, abs=0.3)
    assert solid.mesh.vertices[:, 2].max() == pytest.approx(8.2, abs=0.3)
    assert 36 < len(solid.mesh.faces) < 60_000


def test_vehicles_start_and_see_in_a_mesh(site: trimesh.Trimesh, tmp_path: Path) -> None:
    env = NavigationEnv(2, world=MeshConfig(file=str(write_mesh(site, tmp_path / "a.stl")), **SHORT), lidar=NEAR)
    state = env.reset()
    assert (state["altitude"] == 3.5).all() and not state["collided"].any()
    place = env.world.places[0]
    assert place.ground is None and len(place.candidates) > 200
    pillars = np.array([[-2.0, 0.0], [3.0, 2.0]])
    assert np.linalg.norm(place.candidates[:, None] - pillars, axis=-1).min() > 1.9
    env.simulation.reset(np.arange(2), np.array([[-4.0, 0, 3.5], [1.0, 2.0, 3.5]]), np.zeros(2))
    seen = np.linalg.norm(env.look(slice(None)), axis=-1)
    np.testing.assert_allclose(np.nanmin(seen, axis=1), 1.5, atol=0.02)
    env.close()


def test_a_part_of_a_file_is_chosen(site: trimesh.Trimesh, tmp_path: Path) -> None:
    file = str(write_mesh(site, tmp_path / "a.stl"))
    part = MeshConfig(file=file, size=(8.0, 8.0), centre=(98.0, 50.0), floor=11.0).scene(0)
    assert part.size == (8.0, 8.0)
    assert part.obstacles[0].mesh.vertices[:, 2].min() == pytest.approx(-1.2, abs=1e-4)
    with pytest.raises(UavrlError, match=r"has nothing in 4 × 4 m around \[0.0, 0.0\]: it reaches from \[92.0, 44.0\]"):
        MeshConfig(file=file, size=(4.0, 4.0), centre=(0.0, 0.0)).scene(0)


def test_voxels_are_closed_and_joined() -> None:
    rng = np.random.default_rng(0)
    solid = occupied(rng.uniform(0, 6, (300, 3)), 1.0, 2)
    corners = voxel_mesh(solid, 0.5)
    mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    assert signed_volume(mesh) == pytest.approx(len(solid) * 0.125, rel=1e-5)
    slab = np.stack(np.meshgrid(np.arange(9), np.arange(7), [3], indexing="ij"), -1).reshape(-1, 3)
    assert len(voxel_mesh(slab, 0.2)) == 12


def refused(make: Callable[[], FileWorld], message: str) -> None:
    with pytest.raises(UavrlError, match=message) as told:
        World(make())
    assert "Traceback" not in str(told.value) and "\n" not in str(told.value)


def test_no_file_of_the_kind(tmp_path: Path, points: np.ndarray, site: trimesh.Trimesh) -> None:
    refused(lambda: MeshConfig(file=str(tmp_path / "none.stl")), "There is no file .*none.stl: name one with")
    refused(lambda: MeshConfig(file=str(tmp_path)), "is a folder: name a file")
    refused(lambda: MeshConfig(), r"write env\.world\.file=FILE")
    (tmp_path / "a.txt").write_text("a")
    refused(lambda: MeshConfig(file=str(tmp_path / "a.txt")), "is no STL, OBJ, PLY, GLB, by its name: convert it")
    refused(lambda: MeshConfig(file=str(write_cloud(points, tmp_path / "a.pcd"))), "env=cloud reads point clouds")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 9 0 0\nv 9 9 0\n")
    refused(
        lambda: MeshConfig(file=str(write_cloud(points, tmp_path / "a.ply"))),
        "60,000 points and no triangles: for a point cloud, use env=cloud",
    )
    refused(
        lambda: MeshConfig(file=str(tmp_path / "a.obj")),
        "3 points and no triangles: for a point cloud, convert it to PLY or XYZ, and use env=cloud",
    )
    refused(lambda: CloudConfig(file=str(write_mesh(site, tmp_path / "b.ply"))), "36 triangles, .* use env=mesh")
    (tmp_path / "c.stl").touch()
    refused(lambda: MeshConfig(file=str(tmp_path / "c.stl")), "is empty: wait until it is written")
    refused(lambda: MeshConfig(file="x.stl", seeds=(1, 2)), "A file is one place")


def test_other_units_and_axes(site: trimesh.Trimesh, tmp_path: Path) -> None:
    large, lying = site.copy().apply_scale(1000), site.copy().apply_transform(np.eye(4)[[0, 2, 1, 3]])
    file = str(write_mesh(large, tmp_path / "mm.stl"))
    refused(lambda: MeshConfig(file=file), r"is 16,000 × 12,000 × 8,200 m: .* env\.world\.scale=0\.001")
    assert MeshConfig(file=file, scale=0.001).scene(0).size == pytest.approx(SIZE, abs=1e-3)
    lying.export(tmp_path / "y.stl")
    refused(lambda: MeshConfig(file=str(tmp_path / "y.stl")), r"write env\.world\.up=y, or env\.world\.up=z if it is")
    assert sorted(MeshConfig(file=str(tmp_path / "y.stl"), up="y").scene(0).size) == pytest.approx(sorted(SIZE))
    small = site.copy().apply_scale(0.01)
    refused(lambda: MeshConfig(file=str(write_mesh(small, tmp_path / "s.stl"))), r"is only 0\.16 × 0\.12 × 0\.082 m")


@pytest.mark.parametrize("read_as", ["x", "y", "z"])
@pytest.mark.parametrize("right", ["x", "y", "z"])
def test_the_axis_that_points_up_is_named(right: str, read_as: Any) -> None:
    seen = np.array([20.0 if axis == right else 10.0 for axis in "xyz"])
    turned = seen[list(shape_file.TURNED[read_as])]
    assert other_up(turned, 9.0, read_as) == (None if right == read_as else right)
    assert other_up(turned, 10.0, read_as) is None


def test_a_glb_with_z_up(site: trimesh.Trimesh, tmp_path: Path) -> None:
    site.export(tmp_path / "z.glb")
    refused(lambda: MeshConfig(file=str(tmp_path / "z.glb")), r"write env\.world\.up=z, or env\.world\.up=y if it is")
    assert MeshConfig(file=str(tmp_path / "z.glb"), up="z").scene(0).size == pytest.approx(SIZE, abs=1e-4)


def test_of_a_cloud_with_x_up_is_warned(points: np.ndarray, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It is no reason to refuse it: a street between high houses is seen so, too."""
    assert columns_along(np.array([[0, 0, 0], [1, 0, 0], [1, 5, 0], [1, 5, 9]])).tolist() == [3, 3, 3]
    lying = points[:, [2, 0, 1]]  # x is up
    file = str(write_cloud(lying, tmp_path / "x.npy"))
    upright, said = CloudConfig(file=file).scene(0).size, "write env.world.up=x, or env.world.up=z if it is right"
    assert said in caplog.text and upright == pytest.approx((8.2, SIZE[0]), abs=0.3)
    caplog.clear()
    assert CloudConfig(file=file, up="x").scene(0).size == pytest.approx(SIZE, abs=0.3)
    assert said not in caplog.text
    assert CloudConfig(file=file, up="z").scene(0).size == pytest.approx((8.2, SIZE[0]), abs=0.3)


def terrain(base: float | None) -> trimesh.Trimesh:
    """20 × 20 m of waves, with a flat base and sides if it is given: then it is a closed solid."""
    x, y = np.mgrid[-10:11, -10:11].astype(float)
    top = np.stack([x, y, 0.3 * np.sin(x / 3) * np.cos(y / 3)], -1).reshape(-1, 3)
    index = np.arange(441).reshape(21, 21)
    a, b, c, d = (each.ravel() for each in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    if base is None:
        return trimesh.Trimesh(top, faces)
    border = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]])
    after = np.roll(border, -1)
    sides = [np.stack([border, border + 441, after], 1), np.stack([after, border + 441, after + 441], 1)]
    block = trimesh.Trimesh(
        np.concatenate([top, top * [1, 1, 0] + [0, 0, base]]), np.concatenate([faces, faces[:, ::-1] + 441, *sides])
    )
    assert block.is_watertight and block.volume > 0
    return block


def test_the_top_of_a_solid_is_its_ground() -> None:
    open_, block = floor_of(sampled(terrain(None).triangles)), floor_of(sampled(terrain(-10.0).triangles))
    assert open_[0] == open_[1] == pytest.approx(0.0, abs=0.1)
    assert block == pytest.approx((open_[0], -10.0), abs=0.05)
    assert floor_of(sampled(terrain(-10.0).triangles, 1000)) == pytest.approx((0.0, -10.0), abs=0.2)  # few per column
    assert floor_of(Surface(sampled(terrain(-10.0).triangles).points)) == pytest.approx((-10.0, -10.0))


def test_what_is_no_solid_keeps_its_lowest_floor() -> None:
    turned, room = terrain(None), box((20, 20, 6), (0, 0, 3))
    turned.invert()
    room.invert()
    pillars = [box((2, 2, 6), (x, y, 3)) for x in range(-9, 10, 6) for y in range(-9, 10, 6)]
    house = trimesh.util.concatenate([room, box((22, 22, 8), (0, 0, 3))])  # walls, a floor and a roof of 1 m
    assert floor_of(sampled(room.triangles)) == pytest.approx((0.0, 0.0))
    assert floor_of(sampled(trimesh.util.concatenate(pillars).triangles))[0] == pytest.approx(0.0, abs=0.05)
    assert floor_of(sampled(house.triangles)) == pytest.approx((0.0, -1.0))
    trees = [box((3, 3, 1), (x, y, 7)) for x in range(-9, 10, 3) for y in range(-9, 10, 3)]  # above all of the ground
    roofed = trimesh.util.concatenate([turned, *trees])  # whose ground is open and faces down
    assert floor_of(sampled(roofed.triangles)) == pytest.approx((0.0, 0.0), abs=0.1)
    low, lowest = floor_of(sampled(turned.triangles))
    assert low == lowest == pytest.approx(0.0, abs=0.1)


def test_vehicles_start_above_the_top_of_a_solid(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    block = trimesh.util.concatenate([terrain(-10.0), box((1, 1, 9), (0, 0, 2))])
    block.export(tmp_path / "block.stl")
    with caplog.at_level(logging.INFO, "uavrl"):
        world = World(MeshConfig(file=str(tmp_path / "block.stl"), **SHORT))
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(told) == 1 and "block.stl looks like a closed solid, so its top is taken as the ground" in told[0]
    assert "write env.world.floor=-10.00" in told[0]
    tasks = [world.sample_task(np.random.default_rng(seed)) for seed in range(8)]
    down = LidarConfig(sensor={"elevations": [-90.0], "azimuth_steps": 1})
    seen = Lidar(world.meshes, None, down).scan(np.stack([task.start for task in tasks]), np.stack([np.eye(3)] * 8))
    np.testing.assert_allclose(np.linalg.norm(seen, axis=-1), 3.5, atol=0.4)


@pytest.mark.parametrize("voxel", [0.2, 1.0, 2.0])
def test_the_ground_of_a_cloud_is_the_top_of_its_voxels(voxel: float, tmp_path: Path) -> None:
    x, y = np.mgrid[0:12:0.09, 0:12:0.09]
    np.save(tmp_path / "flat.npy", np.stack([x, y, np.full_like(x, 0.01)], -1).reshape(-1, 3))
    (solid,) = CloudConfig(file=str(tmp_path / "flat.npy"), voxel=voxel).scene(0).obstacles
    assert solid.mesh.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-6)
    assert solid.mesh.vertices[:, 2].min() == pytest.approx(-voxel, abs=1e-6)


def test_a_part_beyond_the_file_is_told(
    site: trimesh.Trimesh, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = str(write_mesh(site, tmp_path / "a.stl"))
    MeshConfig(file=file, size=(SIZE[0] + 0.9, SIZE[1])).scene(0)
    assert "empty space" not in caplog.text
    MeshConfig(file=file, size=(SIZE[0] + 1.2, SIZE[1])).scene(0)
    assert "env.world.size=[17.2,12] around [100.0,50.0] is larger: the rest is empty space without" in caplog.text


def test_no_room_at_the_flight_level(site: trimesh.Trimesh, tmp_path: Path) -> None:
    file = str(write_mesh(trimesh.util.concatenate([site, box((*SIZE, 4.0), (100, 50, 13))]), tmp_path / "a.stl"))
    refused(lambda: MeshConfig(file=file, **SHORT), "free at the flight level of 3.5 m; check env.world.up, floor")


def test_too_much(site: trimesh.Trimesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = str(write_mesh(site, tmp_path / "a.stl"))
    monkeypatch.setattr(file_worlds, "MOST_TRIANGLES", 30)
    refused(lambda: MeshConfig(file=file), "makes 36 triangles, and at most 30 are taken: decimate it, or choose")
    monkeypatch.setattr(shape_file, "MOST_BYTES", 1000)
    refused(lambda: MeshConfig(file=file), "GB are read: decimate it, or cut it")
    wide = site.copy().apply_scale(20)
    monkeypatch.undo()
    refused(
        lambda: MeshConfig(file=str(write_mesh(wide, tmp_path / "w.stl"))), "m² are flown in under a ceiling of 5 m"
    )


@pytest.mark.parametrize("ceiling", [5.0, 25.0])
def test_the_part_that_is_proposed_of_a_large_file_is_taken(ceiling: float, tmp_path: Path) -> None:
    ground = box((800.0, 300.0, 0.1), (0, 0, 0))
    file = str(write_mesh(trimesh.util.concatenate([ground, box((1, 1, 6), (5, 5, 3))]), tmp_path / "w.stl"))
    with pytest.raises(UavrlError, match="one that it covers well") as told:
        MeshConfig(file=file, ceiling=ceiling).scene(0)
    (length, width), (x, y) = (
        [float(each) for each in re.search(rf"env.world.{key}=\[([^\]]*)\]", str(told.value))[1].split(",")]  # type: ignore[index]
        for key in ("size", "centre")
    )
    assert MeshConfig(file=file, ceiling=ceiling, size=(length, width), centre=(x, y)).scene(0).size == (length, width)


def test_a_strip_is_proposed_as_wide_as_it_is() -> None:
    middle, size = file_worlds.best_covered(np.mgrid[0:3001, 0:21].reshape(2, -1).T.astype(float), 100)
    assert size[1] <= 21 and 90 <= size[0] <= 100 and 10 <= middle[1] <= 11


def test_corners_that_are_no_numbers(site: trimesh.Trimesh, tmp_path: Path) -> None:
    broken = site.copy()
    broken.vertices[3] = np.nan
    broken.export(tmp_path / "a.ply")
    refused(lambda: MeshConfig(file=str(tmp_path / "a.ply")), "of 36 triangles have corners that are no finite numbers")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a.stl", "cannot be read as STL"),
        ("a.ply", "is shorter or longer than its header tells: if it is still being written, wait"),
        ("a.glb", "cannot be read as GLB"),
        ("c.pcd", "cannot be read as PCD"),
        ("c.npy", "cannot be read as NPY"),
        ("c.npz", "cannot be read as NPZ"),
    ],
)
def test_a_file_that_is_cut_off(
    name: str, told: str, site: trimesh.Trimesh, points: np.ndarray, tmp_path: Path
) -> None:
    is_mesh = name[0] == "a"
    path = write_mesh(site, tmp_path / name) if is_mesh else write_cloud(points, tmp_path / name)
    path.write_bytes(path.read_bytes()[:-700])
    config: Any = MeshConfig if is_mesh else CloudConfig
    refused(lambda: config(file=str(path)), told)


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_a_pcd_with_fewer_points_than_it_tells(data: str, tmp_path: Path) -> None:
    values = np.arange(60, dtype=np.float32).reshape(20, 3)
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 20\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 20\nDATA {data}\n"
    rows = [" ".join(map(str, row)).encode() + b"\n" if data == "ascii" else row.tobytes() for row in values]
    path = tmp_path / "a.pcd"
    path.write_bytes(head.encode() + b"".join(rows))
    np.testing.assert_array_equal(shape_reader.read_shape(path, 2**30)[0], values)
    path.write_bytes(head.encode() + b"".join(rows[:9]))
    with pytest.raises(ValueError, match="it holds 9 of the 20 points that its header tells"):
        shape_reader.read_shape(path, 2**30)


@pytest.mark.parametrize(
    "face",
    [
        *("f -4 -3 -2", "f -4/1/1 -3/1/1 -2/1/1", "\tf\t1 2 -1"),
        *("f 0 1 2", "f 1 2 0", "f 0/1 1/1 2/1", "f 1 00 2"),
    ],
)
def test_an_obj_with_relative_indices_or_from_0(face: str, tmp_path: Path) -> None:
    corners = "v -5 -5 0\nv 5 -5 0\nv 5 5 0\nv -5 5 0\nvt 0 0\nvn 0 0 1\n"
    path = tmp_path / "a.obj"
    more = "v 0 0 1\n" * 6
    path.write_text(f"# f -1 0\n{corners}{more}f 1 2 3\nf 1/0 2/0 3/0\nf 1//-1 2//-1 3//-1\nf 10 2 3\n")
    assert shape_reader.read_shape(path, 2**30)[1].shape == (4, 3)
    path.write_text(f"{corners}f 1 2 3\n{face}\n")
    with pytest.raises(
        ValueError, match=r"relative \(negative\) indices or an index 0, .* export it with absolute ones"
    ):
        shape_reader.read_shape(path, 2**30)


@pytest.mark.parametrize("name", shape_reader.COMPRESSED)
def test_a_compressed_glb(name: str, site: trimesh.Trimesh, tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(glb({"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_other", name]}))
    with pytest.raises(ValueError, match=f"is compressed with {name}, which is not read: export it without"):
        shape_reader.read_shape(path, 2**30)
    for whole in (b"glTF", glb([]), glb({"extensionsRequired": 5})):  # type: ignore[arg-type]
        path.write_bytes(whole)
        with pytest.raises(Exception) as told:
            shape_reader.read_shape(path, 2**30)
        assert "compressed" not in str(told.value)


def test_a_whole_file_that_is_not_read_is_told_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 9 0 0\nv 9 9 0\nf -3 -2 -1\n")
    refused(
        lambda: MeshConfig(file=str(tmp_path / "a.obj")),
        r"/a\.obj has faces with relative .* absolute ones, from 1 on\.$",
    )


def test_files_without_extent_and_points_far_outside(points: np.ndarray, tmp_path: Path) -> None:
    for count in (1, 9):
        with pytest.raises(UavrlError, match=r"has no extent: all of its points lie at one place"):
            shape_file.to_metres(np.ones((count, 3)), tmp_path, 1.0, "z")
    with pytest.raises(UavrlError, match=r"env\.world\.scale=0\.001, or remove points that lie far outside; at most"):
        shape_file.to_metres(np.vstack([points, [[1e6, 0, 0]]]), tmp_path, 1.0, "z")
    with pytest.raises(UavrlError, match=r"env\.world\.scale=0\.001; at most 5,000 m"):
        shape_file.to_metres(points * 1000, tmp_path, 1.0, "z")


@pytest.mark.parametrize(
    ("offset", "kind", "step"),
    [(5e6, np.float32, "0.5"), (3e5, np.float32, "0.031"), (9e4, np.float32, None), (5e6, np.float64, None)],
)
def test_of_rounded_coordinates_is_warned(
    offset: float, kind: type, step: str | None, points: np.ndarray, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    far = (points + np.array([0, offset, 0])).astype(kind).astype(np.float64)
    shape_file.to_metres(far, tmp_path, 1.0, "z")
    if step is None:
        assert not caplog.records
    else:
        assert f"steps of {step} m: export them as doubles, or move the origin near the site" in caplog.text


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"file": 5}, "file takes the path of a file, got 5: write"),
        ({"file": ["a"]}, "file takes the path of a file, got"),
        ({"centre": 5}, "centre takes x and y in metres, got 5"),
        ({"centre": "ab"}, "centre takes x and y in metres, got 'ab'"),
        ({"centre": (1, 2, 3)}, "centre takes x and y in metres, got"),
        ({"centre": (1, [2])}, "centre must be finite numbers, got"),
        ({"centre": (1, "a")}, "centre must be finite numbers, got"),
        ({"size": 5}, "size takes a list of numbers, got 5"),
        ({"size": (1, 2, 3)}, "size takes two lengths in metres, got"),
        ({"size": (1, -2)}, "size must be above 0, got"),
        ({"floor": "a"}, "floor must be a finite number, got 'a'"),
        ({"floor": (1, 2)}, "floor must be a finite number, got"),
        ({"scale": "x"}, "scale must be a finite number, got 'x'"),
        ({"scale": (1, 1, 1)}, "scale must be a finite number, got"),
        ({"scale": 0}, "scale must be above 0, got 0"),
        ({"up": "w"}, "up must be x, y, z or None, got 'w'"),
        *(({"voxel": value}, r"voxel must be a finite number from 0\.02 to 5, got") for value in (0.001, 50, -1, "a")),
        ({"voxel": float("nan")}, r"voxel must be a finite number from 0\.02 to 5, got nan"),
        *(({"min_points": value}, "min_points must be a whole number, 1 or more, got") for value in (0, 1.5, "2")),
    ],
)
def test_settings_that_are_no_values(given: dict[str, Any], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        CloudConfig(**{"file": "a.npy", **given})


def test_a_file_that_is_being_written(site: trimesh.Trimesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mesh(site, tmp_path / "a.stl")
    monkeypatch.setattr(time, "sleep", lambda seconds: path.write_bytes(path.read_bytes() + b"more"))
    refused(lambda: MeshConfig(file=str(path)), "is being written: wait until it is complete")
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    stamps = iter([(1, 1), (2, 2)])
    monkeypatch.setattr(shape_file, "_stamp", lambda path: next(stamps))
    refused(lambda: MeshConfig(file=str(write_mesh(site, path))), "has changed while it was read|cannot be read")


def glb(about: dict[str, Any], content: bytes = b"") -> bytes:
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(content), 0x004E4942) + content if content else b""
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def test_a_small_file_that_claims_to_be_huge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shape_file, "MOST_MEMORY", 2**32)
    accessors = [
        {"componentType": 5126, "count": 10**9, "type": "VEC3"},
        {"componentType": 5125, "count": 3 * 10**9, "type": "SCALAR"},
    ]
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]
    about = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0, "nodes": [{"mesh": 0}]}
    (tmp_path / "a.glb").write_bytes(glb({**about, "meshes": meshes, "accessors": accessors}))
    refused(lambda: MeshConfig(file=str(tmp_path / "a.glb")), "unpacks to more than 4 GB|cannot be read as GLB")
    np.savez_compressed(tmp_path / "a.npz", points=np.zeros((1000, 3)))
    monkeypatch.setattr(shape_file, "MOST_MEMORY", 20_000)
    monkeypatch.setattr(shape_reader, "limit_memory", lambda most: None)
    with pytest.raises(MemoryError):
        shape_reader.read_shape(tmp_path / "a.npz", 20_000)


def test_a_file_reads_no_other_files(site: trimesh.Trimesh, tmp_path: Path) -> None:
    secret = tmp_path / "secret.bin"
    secret.write_bytes(np.zeros((3, 3), np.float32).tobytes())
    about = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "scene": 0,
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": "secret.bin", "byteLength": 36}],
    }
    (tmp_path / "a.glb").write_bytes(glb(about))
    refused(lambda: MeshConfig(file=str(tmp_path / "a.glb")), "refers to no others")
    os.mkfifo(tmp_path / "pipe.mtl")  # whoever opens it waits for ever
    text = "mtllib pipe.mtl\nusemtl none\n" + trimesh.exchange.obj.export_obj(site)
    (tmp_path / "a.obj").write_text(text)
    assert MeshConfig(file=str(tmp_path / "a.obj")).scene(0).size == pytest.approx(SIZE, abs=1e-3)


def test_nothing_in_an_array_file_is_executed(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    np.save(tmp_path / "a.npy", np.array([Trap()], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "a.npz", points=np.array([Trap()], dtype=object))
    for name in ("a.npy", "a.npz"):
        refused(lambda name=name: CloudConfig(file=str(tmp_path / name)), "cannot be read as NP")  # type: ignore[misc]
    assert not (tmp_path / "sprung").exists()


def test_voxels_without_points(points: np.ndarray, tmp_path: Path) -> None:
    file = str(write_cloud(points, tmp_path / "a.npy"))
    refused(lambda: CloudConfig(file=file, voxel=0.05, min_points=1000), "none of its voxels of 0.05 m holds 1000")
    np.save(tmp_path / "b.npy", np.full((9, 3), np.nan))
    refused(lambda: CloudConfig(file=str(tmp_path / "b.npy")), "has no point whose numbers are finite")
    np.save(tmp_path / "c.npy", np.zeros((9, 2)))
    refused(lambda: CloudConfig(file=str(tmp_path / "c.npy")), r"holds an array of shape \[9, 2\]")


def test_a_cloud_repeats_when_it_is_copied(points: np.ndarray, tmp_path: Path) -> None:
    config = CloudConfig(file=str(write_cloud(points, tmp_path / "a.npy")), **SHORT)
    one, other = World(config), World(replace(config))
    for mine, yours in zip(one.meshes, other.meshes, strict=True):
        np.testing.assert_array_equal(mine.vertices, yours.vertices)
    np.testing.assert_array_equal(one.places[0].candidates, other.places[0].candidates)
    task = one.sample_task(np.random.default_rng(0))
    assert np.linalg.norm(task.goal[:2] - task.start[:2]) >= 5.0 and task.world_seed == 0
