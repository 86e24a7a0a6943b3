"""Embree, or one sentence where it has no wheel."""

from uavrl.errors import MissingSimulator

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except ModuleNotFoundError as error:
    raise MissingSimulator(error.name or "embreex") from error

__all__ = ["EmbreeScene", "TriangleMesh"]
