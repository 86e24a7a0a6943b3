"""Meshes and point clouds from files: any format gives the same place, and what is no place is told in a sentence."""

from __future__ import annotations

import json
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
from uavrl.envs.navigation import NavigationEnv
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
    np.testing.assert_allclose([low[2], high[2]], [0.0, 8.2], atol=1e-4)


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
    refused(lambda: MeshConfig(file=str(write_cloud(points, tmp_path / "a.ply"))), "60,000 points and no triangles")
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


@pytest.mark.parametrize("name", ["a.stl", "a.ply", "a.glb", "c.pcd", "c.npy", "c.npz"])
def test_a_file_that_is_cut_off(name: str, site: trimesh.Trimesh, points: np.ndarray, tmp_path: Path) -> None:
    is_mesh = name[0] == "a"
    path = write_mesh(site, tmp_path / name) if is_mesh else write_cloud(points, tmp_path / name)
    path.write_bytes(path.read_bytes()[:-700])
    config: Any = MeshConfig if is_mesh else CloudConfig
    refused(lambda: config(file=str(path)), "cannot be read as")


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
