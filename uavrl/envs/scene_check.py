"""Checks the scene that a world returns, before a place is built of it."""

import numpy as np

from uavrl.envs.rules import Scene, WorldRules
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh


def checked_scene(config: WorldRules, number: int) -> Scene:
    """The scene of ``config.seeds[number]``, whose size is two floats.

    Raises:
        UavrlError: If it is no scene, or has another size than the world, or triangles whose corners are not there or
            are no numbers: cutting up these would never end.
    """
    scene, name = config.scene(number), f"{type(config).__name__}.scene"
    if not isinstance(scene, Scene):
        raise UavrlError(
            f"{name} must return a Scene, got {type(scene).__name__}: return Scene([Solid('wall', mesh)], self.size)."
        )
    given = np.asarray(scene.size, dtype=object)
    if given.shape != (2,) or not all(
        isinstance(each, int | float | np.number) and 0 < each < np.inf for each in given
    ):
        raise UavrlError(f"{name} must return a size of two lengths above 0, in m, got {scene.size!r}: use self.size.")
    size = (float(given[0]), float(given[1]))
    if config.size is not None and not np.allclose(size, config.size):  # a world from a file may have none
        raise UavrlError(
            f"{name} returns a size of {size} m, but the world's size is {config.size} m, by which places are laid "
            f"out: return self.size, or set size={size}."
        )
    if scene.ground is not None and not isinstance(scene.ground, HeightField):
        raise UavrlError(f"{name} must return a HeightField or None as ground, got {type(scene.ground).__name__}.")
    if scene.ground is not None and not np.isfinite(scene.ground.heights).all():
        raise UavrlError(f"{name} returns a ground with heights that are no finite numbers.")
    if not np.iterable(scene.obstacles):
        raise UavrlError(f"{name} must return a list of Solids, got {type(scene.obstacles).__name__}.")
    for index, obstacle in enumerate(scene.obstacles):
        _check_mesh(f"obstacle {index} that {name} returns", obstacle)
    return Scene(scene.obstacles, size, *scene[2:])


def _check_mesh(name: str, obstacle: object) -> None:
    mesh = getattr(obstacle, "mesh", None)
    if not isinstance(mesh, Mesh) or not isinstance(getattr(obstacle, "kind", None), str):
        found = type(obstacle).__name__ if mesh is None else f"{type(obstacle).__name__} of {type(mesh).__name__}"
        raise UavrlError(
            f"The {name} must be a Solid of a Mesh, got a {found}: write Solid('wall', Mesh(vertices, faces))."
        )
    if bad := int((~np.isfinite(mesh.vertices)).any(1).sum()):
        raise UavrlError(f"The {name} has {bad:,} of {len(mesh.vertices):,} vertices that are no finite numbers.")
    if len(mesh.faces) and not (mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)):
        raise UavrlError(
            f"The {name} has faces of the vertices {mesh.faces.min()} to {mesh.faces.max()}, but its vertices are 0 to "
            f"{len(mesh.vertices) - 1}."
        )
