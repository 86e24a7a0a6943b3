"""What a constructor takes, read from its source: nothing is imported, so that a mistake is told before torch loads."""

import ast
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_PLAIN = {kind.__name__: kind for kind in (bool, int, float, str, tuple, list, dict)}
_IMPORTED = ("typing", "collections.abc", "uavrl.ranges")  # modules whose names are taken as they are
_HEAVY = ("torch", "torchrl", "tensordict")


class _AnyAttribute(type):
    def __getattr__(cls, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return cls

    def __getitem__(cls, item: object) -> type:
        return cls


class Other(metaclass=_AnyAttribute):
    """The type of an argument that is no plain data, such as a network."""


@cache
def signature(target: str) -> dict[str, Any] | None:
    """The types of the arguments that a class takes by name; ``Any`` where none is told.

    A constructor with ``**kwargs`` also takes what the last of its bases takes.
    """
    module, _, name = target.rpartition(".")
    statement = _statements(module).get(name)
    if isinstance(statement, ast.ImportFrom):
        return signature(f"{_imported_from(statement, module)}.{_original(statement, name)}")
    if not isinstance(statement, ast.ClassDef):
        return None
    init = next(
        (node for node in statement.body if isinstance(node, ast.FunctionDef) and node.name == "__init__"), None
    )
    inherited: dict[str, Any] = {}
    if init is None or init.args.kwarg is not None:
        bases = [signature(f"{module}.{base.id}") for base in statement.bases if isinstance(base, ast.Name)]
        inherited = next((known for known in reversed(bases) if known), inherited)
    return inherited | {name: _evaluated(annotation, module) for name, annotation in _arguments(statement, init)}


def classes(module: str) -> list[str]:
    """The names of the classes that a module holds or imports."""
    held = _statements(module).items()
    return [name for name, node in held if isinstance(node, ast.ClassDef | ast.ImportFrom) and name[:1].isupper()]


def _arguments(statement: ast.ClassDef, init: ast.FunctionDef | None) -> Iterator[tuple[str, ast.expr | None]]:
    if init is not None:
        for argument in [*init.args.args[1:], *init.args.kwonlyargs]:
            yield argument.arg, argument.annotation
    elif any("dataclass" in ast.unparse(decorator) for decorator in statement.decorator_list):
        for node in statement.body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                yield node.target.id, node.annotation


@cache
def _statements(module: str) -> dict[str, ast.stmt]:
    """What the top of a module defines or imports, by name."""
    path = _source(module)
    if path is None:
        return {}
    found: dict[str, ast.stmt] = {}
    for node in _top(ast.parse(path.read_text(encoding="utf-8")).body):
        if isinstance(node, ast.ClassDef):
            found[node.name] = node
        elif isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name: node for alias in node.names}
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found[node.targets[0].id] = node
    return found


def _top(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for node in body:
        yield from _top(node.body) if isinstance(node, ast.If) else [node]


def _source(module: str) -> Path | None:
    """The file of a module; only its topmost package is looked up, which imports nothing."""
    top, *below = module.split(".")
    spec = find_spec(top) if top else None
    if spec is None:
        return None
    if not below and not spec.submodule_search_locations:
        return Path(spec.origin) if spec.origin else None
    for folder in spec.submodule_search_locations or ():
        stem = Path(folder, *below)
        for path in (stem / "__init__.py", stem.with_suffix(".py")):
            if path.is_file():
                return path
    return None


def _imported_from(statement: ast.ImportFrom, module: str) -> str:
    if not statement.level:
        return str(statement.module)
    source = _source(module)
    package = module.split(".") if source is not None and source.stem == "__init__" else module.split(".")[:-1]
    package = package[: len(package) - statement.level + 1]
    return ".".join([*package, *filter(None, [statement.module])])


def _original(statement: ast.ImportFrom, name: str) -> str:
    return next(alias.name for alias in statement.names if (alias.asname or alias.name) == name)


def _evaluated(annotation: ast.expr | None, module: str) -> Any:
    if annotation is None:
        return Any
    try:
        return eval(ast.unparse(annotation), {"__builtins__": {}}, _Names(module))
    except Exception:
        return Any


def _is_heavy(module: str) -> bool:
    return module.partition(".")[0] in _HEAVY


class _Names(dict[str, Any]):
    """The names in a module that mean plain data; every other one is :class:`Other`."""

    def __init__(self, module: str) -> None:
        super().__init__(_PLAIN)
        self._module = module

    def __missing__(self, name: str) -> Any:
        statement = _statements(self._module).get(name)
        if isinstance(statement, ast.ImportFrom):
            source = _imported_from(statement, self._module)
            if source in _IMPORTED:
                return getattr(import_module(source), _original(statement, name))
            return Other if _is_heavy(source) else _Names(source)[_original(statement, name)]
        if isinstance(statement, ast.Assign):
            return _evaluated(statement.value, self._module)
        decorators = statement.decorator_list if isinstance(statement, ast.ClassDef) else []
        plain = any("dataclass" in ast.unparse(decorator) for decorator in decorators)
        if plain and not _is_heavy(self._module):
            return getattr(import_module(self._module), name)  # can be made and checked at once
        return Other
