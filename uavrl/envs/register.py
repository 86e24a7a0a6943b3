"""Registration with Gymnasium, without importing Gymnasium: ``import uavrl`` runs it."""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

VALLEY = "uavrl/Valley-v0"
_REGISTRY = "gymnasium.envs.registration"


def register_with_gymnasium() -> None:
    """Register ``uavrl/Valley-v0`` now if Gymnasium is loaded, and otherwise as soon as it is.

    Gymnasium 1.0 loads no plugins: ``uavrl:uavrl/Valley-v0`` makes it import ``uavrl``, which may have been imported
    before Gymnasium was.
    """
    if _REGISTRY in sys.modules:
        _register(sys.modules[_REGISTRY])
    elif not any(isinstance(finder, _WhenLoaded) for finder in sys.meta_path):
        sys.meta_path.insert(0, _WhenLoaded())


def _register(registration: ModuleType) -> None:
    if VALLEY not in registration.registry:
        registration.register(
            id=VALLEY,
            entry_point="uavrl.envs.gym:make_valley",
            vector_entry_point="uavrl.envs.gym_vector:make_valleys",
        )


class _WhenLoaded:  # not a MetaPathFinder, whose module takes 30 ms to import
    """Registers the environment right after Gymnasium's registry has been loaded, once."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != _REGISTRY:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            execute(module)
            _register(module)

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec
