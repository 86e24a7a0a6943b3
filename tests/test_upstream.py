"""What is private in TorchRL, tensordict and torch, and used: it is still there, and no more of it is used."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import pkgutil
from pathlib import Path

import pytest
import tensordict
import torch
from tensordict import TensorDict
from torchrl.checkpoint import StateDictCheckpointAdapter

import uavrl
from uavrl import upstream
from uavrl.runs import trust

THEIRS = ("torch", "torchrl", "tensordict")
PUBLIC = {"_asdict", "_target_"}  # of named tuples and of Hydra


def named(path: str) -> type:
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name not in PUBLIC


def defines(cls: type, name: str) -> bool:
    """Whether a class has the name, or sets it on its objects."""
    theirs = [base for base in cls.__mro__ if base.__module__.split(".")[0] in THEIRS]
    return hasattr(cls, name) or any(f"self.{name}" in inspect.getsource(base) for base in theirs)


@pytest.mark.parametrize(
    ("path", "name"), [(path, name) for path, names in upstream.ATTRIBUTES.items() for name in names]
)
def test_the_name_is_still_there(path: str, name: str) -> None:
    assert defines(named(path), name), f"{path}.{name} has moved: what uses it in uavrl?"


def test_lerp_moves_all_by_a_share() -> None:
    targets = [torch.tensor([0.0, 4.0]), torch.tensor([1.0])]
    upstream.lerp(targets, [torch.tensor([8.0, 0.0]), torch.tensor([3.0])], 0.25)
    assert [target.tolist() for target in targets] == [[2.0, 3.0], [1.5]]


def test_inductor_compiles_a_graph_and_can_draw_as_torch_draws() -> None:
    import torch._inductor.config

    assert list(inspect.signature(torch._inductor.compile).parameters)[:3] == ["gm", "example_inputs", "options"]
    assert torch._inductor.config.fallback_random is False


def test_rows_are_those_of_the_index() -> None:
    stored = TensorDict({"a": torch.arange(4.0), "b": {"c": torch.arange(8).reshape(4, 2)}}, [4])
    index = torch.tensor([3, 0, 3])
    found = upstream.rows(stored, index)
    assert found.batch_size == torch.Size([3]) and (found == stored[index]).all()


def test_a_number_is_added_to_all() -> None:
    values = [torch.tensor(3.0), torch.tensor([1.0, 2.0])]
    upstream.add(values, 1)
    assert [value.tolist() for value in values] == [4.0, [2.0, 3.0]]


def test_a_state_dict_is_decoded_as_torchrl_encoded_it(tmp_path: Path) -> None:
    component = torch.nn.Linear(2, 1)
    adapter = StateDictCheckpointAdapter()
    adapter.save(component, tmp_path, args=(), kwargs={})
    schema = json.loads((tmp_path / adapter.schema_filename).read_text())
    tensors = tensordict.load(tmp_path / adapter.state_directory, allow_pickle=False)
    found = upstream.decode_state_dict(schema, tensors, None)
    assert found.keys() == component.state_dict().keys() and (found["weight"] == component.weight).all()


def test_tensordicts_call_themselves_as_a_checkpoint_may() -> None:
    assert str(TensorDict) == trust._COLLECTION


# ---------------------------------------------------------------------- and nothing else


FILES = sorted(Path(uavrl.__file__).parent.rglob("*.py"))
TREES = {file: ast.parse(file.read_text(encoding="utf-8")) for file in FILES}
LISTED = {name for names in upstream.ATTRIBUTES.values() for name in names}


def test_private_functions_are_imported_in_one_file() -> None:
    found = []
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            names: list[str] = []
            if isinstance(node, ast.ImportFrom):
                names = [*str(node.module).split("."), *(alias.name for alias in node.names)]
            elif isinstance(node, ast.Import):
                names = [part for alias in node.names for part in alias.name.split(".")]
            if names and names[0] in THEIRS and any(map(private, names)):
                found.append(file.name)
    assert set(found) == {"upstream.py"}


def own_names() -> set[str]:
    """What uavrl itself calls with an underscore, its overrides among them."""
    found = set()
    for tree in TREES.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.add(node.name)
            elif isinstance(node, ast.Attribute | ast.Name) and isinstance(node.ctx, ast.Store):
                found.add(node.attr if isinstance(node, ast.Attribute) else node.id)
    return found


def test_no_other_attribute_is_used() -> None:
    own = own_names()
    asked = {
        node.attr: f"{file.name}:{node.lineno}"
        for file, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and private(node.attr) and file.name != "upstream.py"
    }
    assert {name: place for name, place in asked.items() if name not in own | LISTED} == {}


def test_no_other_method_is_overridden() -> None:
    found = {}
    for module in pkgutil.walk_packages(uavrl.__path__, "uavrl."):
        for cls in vars(importlib.import_module(module.name)).values():
            if not (inspect.isclass(cls) and cls.__module__ == module.name):
                continue
            theirs = [base for base in cls.__mro__ if base.__module__.split(".")[0] in THEIRS]
            for name, value in vars(cls).items():
                written = (
                    getattr(inspect.unwrap(value), "__module__", None) == module.name if callable(value) else False
                )
                if private(name) and written and any(name in vars(base) for base in theirs) and name not in LISTED:
                    found[f"{cls.__name__}.{name}"] = theirs[0].__name__
    assert found == {}
