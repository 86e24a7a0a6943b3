"""What somebody else may have written is checked before any of it is loaded: nothing in it can run.

tensordict's loader unpickles ``other.pickle`` and ``pickle.pkl`` where it meets them, unless it is told not to, and
TorchRL's does not tell it; a pickle can run any program. uavrl writes neither, so that a checkpoint is read against a
list of all that uavrl does write, and refused where it holds anything else.
"""

import json
import math
import re
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from uavrl.errors import UavrlError

MANIFEST = "manifest.json"
_COMPONENT = re.compile(r"components/\d{4}-([\w.]+)")
_STATE = re.compile(r"state\.json|state/(meta\.json|tensor_\d{8}\.memmap)")
_BUFFER = re.compile(
    r"length\.json|writer/metadata\.json|sampler/(sampler_metadata\.json|(sum|min)tree\.memmap)"
    r"|storage/(\w+/)*(meta\.json|\w+\.memmap)"
)
_STORAGE = re.compile(r"storage_metadata\.json|(\w+/)*(meta\.json|\w+\.memmap)")
_FILES = {"torchrl.state_dict": _STATE, "torchrl.dump_load": _BUFFER}  # what each of TorchRL's adapters may read
_COLLECTION = "<class 'tensordict._td.TensorDict'>"
_KINDS = {"tensor", "value", "dict", "ordered_dict", "list", "tuple", "torch_size"}  # in a state.json
_BYTES = {
    **dict.fromkeys(("torch.bool", "torch.uint8", "torch.int8"), 1),
    **dict.fromkeys(("torch.int16", "torch.float16", "torch.bfloat16"), 2),
    **dict.fromkeys(("torch.int32", "torch.float32"), 4),
    **dict.fromkeys(("torch.int64", "torch.float64"), 8),
}


def check_archive(path: Path) -> dict[str, Any]:
    """The manifest of a checkpoint, found to hold only what uavrl writes, uncompressed, and to be whole.

    Raises:
        UavrlError: when it holds anything else.
        zipfile.BadZipFile: when it is damaged.
    """
    with zipfile.ZipFile(path) as archive:
        sizes = {info.filename: info.file_size for info in archive.infolist()}
        stored = all(info.compress_type == zipfile.ZIP_STORED for info in archive.infolist())
        if not stored or len(sizes) < len(archive.infolist()) or sum(sizes.values()) > path.stat().st_size:
            raise _refused(path, "members that are compressed, or lie over each other")
        broken = archive.testzip()
        if broken is not None:
            raise zipfile.BadZipFile(f"{broken} fails its checksum")
        manifest: dict[str, Any] = json.loads(archive.read(MANIFEST))
        _check_names(path, manifest["components"], set(sizes))
        for name in sizes:
            if name.endswith("/state.json"):
                for kind in set(_kinds(json.loads(archive.read(name)))) - _KINDS:
                    raise _refused(path, f"{name} with a {str(kind)[:80]!r}")
            elif name.endswith("/meta.json"):
                _check_tensors(path, name, json.loads(archive.read(name)), sizes)
    return manifest


def check_tensors(folder: Path) -> None:
    """Refuses a folder that holds anything but a tensordict of plain tensors, as TorchRL's storages write it.

    Raises:
        UavrlError: when it holds anything else, or a tensor of another size than it is said to have.
        OSError, ValueError: when it is damaged.
    """
    sizes = {
        path.relative_to(folder).as_posix(): path.stat().st_size for path in folder.rglob("*") if not path.is_dir()
    }
    for name in sizes:
        if _STORAGE.fullmatch(name) is None:
            raise _refused(folder, name)
        if name.endswith("meta.json"):
            _check_tensors(folder, name, json.loads((folder / name).read_bytes()), sizes)
    if "meta.json" not in sizes:
        raise FileNotFoundError(f"meta.json is missing in {folder}")


def check_links(folder: Path, names: Iterable[str]) -> None:
    """Refuses a folder where a link among ``names``, or in one of these folders, leads out of it."""
    inside = folder.resolve()
    for name in names:
        for path in (folder / name, *(folder / name).rglob("*")):
            if path.is_symlink() and not _leads_into(path, inside) and not _left_by_wandb(path, folder):
                raise UavrlError(
                    f"{path} is a link that leads out of {folder}: put what it means in its place, or, to keep it "
                    f"on another disk, move all of {folder} there and link that."
                )


def _leads_into(link: Path, folder: Path) -> bool:
    try:
        link.stat()
    except FileNotFoundError:
        pass  # what it names is not there yet
    except OSError:  # a link to itself
        return False
    return link.resolve().is_relative_to(folder)


def _left_by_wandb(link: Path, folder: Path) -> bool:
    """Whether a link is one of those that wandb makes to its own log files. It makes new ones, and follows none."""
    return (folder / "logs/wandb") in link.parents and link.suffix == ".log" and not link.is_dir()


def _check_names(path: Path, components: dict[str, Any], names: set[str]) -> None:
    """The archive holds what its manifest lists and nothing else, and all of it is of a known kind."""
    listed = {MANIFEST}
    for name, record in components.items():
        place = _COMPONENT.fullmatch(record["path"])
        if place is None or place[1] != name or record["adapter"] not in _FILES:
            raise _refused(path, f"a component {name!r} of another making")
        for file in record["files"]:
            if _FILES[record["adapter"]].fullmatch(file) is None:
                raise _refused(path, f"{record['path']}/{file}")
            listed.add(f"{record['path']}/{file}")
    if listed != names:
        raise _refused(path, f"{min(listed ^ names)} without the other of member and listing")


def _kinds(node: Any) -> Iterator[Any]:
    """All kinds of value that a state dict's json names."""
    if isinstance(node, dict):
        yield node.get("kind")
        if node.get("kind") == "value":
            yield "value" if node["value"] is None or isinstance(node["value"], (str, int, float)) else "structure"
        yield from (kind for key in ("items", "metadata") for kind in _kinds(node.get(key)))
    elif isinstance(node, list):
        for item in node:
            yield from _kinds(item)


def _check_tensors(path: Path, name: str, about: dict[str, Any], sizes: dict[str, int]) -> None:
    """A tensordict's json names plain tensors, each as large as its file, and plain tensordicts below it."""
    folder = name.removesuffix("meta.json")
    if about["_type"] != _COLLECTION:
        raise _refused(path, f"{name} with a {str(about['_type'])[:80]!r}")
    for key, entry in about.items():
        if key in ("_type", "shape", "device"):
            continue
        if not isinstance(entry, dict) or re.fullmatch(r"\w+", key) is None:
            raise _refused(path, f"{name} with the entry {key[:80]!r}")
        if "type" in entry:
            whole = entry["type"] == "TensorDict"
            if whole and f"{folder}{key}/meta.json" not in sizes:
                raise UavrlError(
                    f"{path} has no {folder}{key}/meta.json, so it is incomplete, and none of it was loaded: copy or "
                    f"write it again."
                )
        else:
            size, there = _size(entry), sizes.get(f"{folder}{key}.memmap", 0)
            whole = size == there
            if 0 <= there < size:
                raise UavrlError(
                    f"{path}: {folder}{key}.memmap has {there:,} of {size:,} bytes, so it is incomplete, and none of "
                    f"it was loaded: copy or write it again."
                )
        if not whole:
            raise _refused(path, f"{name}, which does not describe {key}")


def _size(entry: dict[str, Any]) -> int:
    """The bytes of a tensor; -1 for what is none."""
    shape, item = entry.get("shape"), _BYTES.get(str(entry.get("dtype")))
    sound = isinstance(shape, list) and all(type(length) is int and length >= 0 for length in shape)
    return math.prod(shape) * item if sound and item and not entry.get("is_nested") else -1  # type: ignore[arg-type]


def _refused(path: Path, what: str) -> UavrlError:
    kind = "folder" if path.is_dir() else "checkpoint"
    return UavrlError(
        f"The {kind} {path} holds {what}, which uavrl does not write: none of it was loaded, as it may be meant "
        f"to run a program; ask whoever made it for the folder that uavrl-export writes."
    )
