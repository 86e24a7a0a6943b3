"""Pickles and other lies in files that somebody else made."""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import NonTensorData, NonTensorStack

EVERYTHING = ["fork=on", "lifeguard=linear", "buffer=prioritized", "backward_reward=abr"]  # the most components
COMPONENTS = [
    "backward_reward",
    "collector",
    "episode_log",
    "log",
    "loss_module",
    "policy",
    "random_state",
    "replay",
    "stepper",
    "trainer",
]
STORAGES = ["storage", "storage/transitions", "storage/transitions/next", "sampler", "writer"]
PLACES = [f"{c}/state" for c in COMPONENTS] + [f"replay_data/{s}" for s in STORAGES]


FOREIGN_CONFIGS = {  # a line in a config.yaml, and what is said of it
    "environment": ("run_dir: ${oc.env:A_SECRET}", "it holds '${oc.env:A_SECRET}' to work out"),
    "resolver": ("device: ${oc.decode:cpu}", "it holds '${oc.decode:cpu}' to work out"),
    "key": ("? ${oc.env:A_SECRET}\n: 1", "it holds '${oc.env:A_SECRET}' to work out"),
    "tag": ("run_dir: !!python/object/apply:pathlib.Path.touch [ran]", "could not determine a constructor"),
    "alias": ("a: &a [1]\nb: *a", "it holds an alias"),
    "target": ("_target_: pathlib.Path.touch\n_args_: [ran]", "_target_"),
    "callback": ("hydra: {callbacks: {a: {_target_: os.mkdir, path: ran}}}", "hydra"),
    "size": ("x: '" + "y" * 1_000_000 + "'", "expected at most 1,000,000 bytes"),
}
MANIFESTS = [b"[]", b"{", b"[" * 100_000, b'{"components": [1]}', b"\xff"]
Members = dict[str, bytes]


class Payload:
    """Unpickling it makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def rewrite(path: Path, change: Callable[[Members], None], compression: int = zipfile.ZIP_STORED) -> None:
    """Changes a checkpoint's members; its manifest lists those that are new."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    before = set(members)
    change(members)
    manifest = json.loads(members["manifest.json"])
    for record in manifest["components"].values():
        new = [name for name in set(members) - before if name.startswith(record["path"] + "/")]
        record["files"] += [name.removeprefix(record["path"] + "/") for name in new]
    members["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def place(members: Members, component: str) -> str:
    path: str = json.loads(members["manifest.json"])["components"][component]["path"]
    return path


def change_json(members: Members, name: str, **values: Any) -> None:
    members[name] = json.dumps({**json.loads(members[name]), **values}).encode()


def plant(folder: str, mark: Path) -> Callable[[Members], None]:
    """Makes a folder one that tensordict unpickles; ``folder`` is a component and what lies below it."""

    def change(members: Members) -> None:
        component, _, below = folder.partition("/")
        where = f"{place(members, component)}/{below}"
        members[f"{where}/other.pickle"] = pickle.dumps({"data": Payload(mark)})
        if f"{where}/meta.json" in members:
            change_json(members, f"{where}/meta.json", _type=str(NonTensorData))

    return change


def a_stack_of_pickles(members: Members, mark: Path) -> None:
    where = place(members, "policy") + "/state"
    members[f"{where}/pickle.pkl"] = pickle.dumps([Payload(mark)])
    change_json(members, f"{where}/meta.json", _type=str(NonTensorStack), stack_dim=0, device="cpu", data="pickle.pkl")


def a_pickle_under_a_tensors_name(members: Members, mark: Path) -> None:
    where = place(members, "policy") + "/state"
    members[f"{where}/tensor_00000099.memmap"] = pickle.dumps(Payload(mark))
    change_json(members, f"{where}/meta.json", _type=str(NonTensorData))


def a_file_of_torch_save(members: Members, mark: Path) -> None:
    members[place(members, "policy") + "/state.pt"] = pickle.dumps(Payload(mark))


def an_archive_in_the_archive(members: Members, mark: Path) -> None:
    members[place(members, "policy") + "/state.tdz"] = b""


def a_folder_that_the_tensors_do_not_name(members: Members, mark: Path) -> None:
    members[place(members, "policy") + "/state/deeper/meta.json"] = b"{}"


def another_value_in_the_state(members: Members, mark: Path) -> None:
    name = place(members, "policy") + "/state.json"
    state = json.loads(members[name])
    state["items"][0][1] = {"kind": "path", "value": "/etc/passwd"}
    members[name] = json.dumps(state).encode()


def a_member_that_leaves_the_folder(members: Members, mark: Path) -> None:
    manifest = json.loads(members["manifest.json"])
    record = manifest["components"]["policy"]
    for file in record["files"]:
        members[f"components/../../{mark.name}/{file}"] = members.pop(f"{record['path']}/{file}")
    record["path"] = f"components/../../{mark.name}"
    members["manifest.json"] = json.dumps(manifest).encode()


def a_component_in_anothers_folder(members: Members, mark: Path) -> None:
    manifest = json.loads(members["manifest.json"])
    manifest["components"]["policy"]["path"] = manifest["components"]["loss_module"]["path"]
    members["manifest.json"] = json.dumps(manifest).encode()


def another_adapter(members: Members, mark: Path) -> None:
    manifest = json.loads(members["manifest.json"])
    manifest["components"]["policy"]["adapter"] = "torchrl.json"
    members["manifest.json"] = json.dumps(manifest).encode()


def a_member_that_is_not_listed(members: Members, mark: Path) -> None:
    members["components/9999-more/state.json"] = b"{}"


def a_tensor_larger_than_its_file(members: Members, mark: Path) -> None:
    name = place(members, "policy") + "/state/meta.json"
    entry = json.loads(members[name])["tensor_00000000"]
    change_json(members, name, tensor_00000000={**entry, "shape": [2**40]})


def a_key_that_leaves_the_folder(members: Members, mark: Path) -> None:
    name = place(members, "policy") + "/state/meta.json"
    change_json(members, name, **{"../../0000-collector/state/": {"type": "TensorDict"}})


def a_nested_tensor(members: Members, mark: Path) -> None:
    name = place(members, "policy") + "/state/meta.json"
    entry = json.loads(members[name])["tensor_00000000"]
    change_json(members, name, tensor_00000000={**entry, "is_nested": True})


CHANGES = [
    a_stack_of_pickles,
    a_pickle_under_a_tensors_name,
    a_file_of_torch_save,
    an_archive_in_the_archive,
    a_folder_that_the_tensors_do_not_name,
    another_value_in_the_state,
    a_member_that_leaves_the_folder,
    a_component_in_anothers_folder,
    another_adapter,
    a_member_that_is_not_listed,
    a_tensor_larger_than_its_file,
    a_key_that_leaves_the_folder,
    a_nested_tensor,
]


def an_array_of_objects(path: Path, mark: Path) -> None:
    np.savez(path, about=np.array([Payload(mark)], dtype=object))


def a_bare_pickle(path: Path, mark: Path) -> None:
    path.write_bytes(pickle.dumps(Payload(mark)))


def a_bare_array_of_objects(path: Path, mark: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.array([Payload(mark)], dtype=object))


def a_very_deep_json(path: Path, mark: Path) -> None:
    np.savez(path, about=np.array("[" * 100_000))


NO_FLIGHTS = [an_array_of_objects, a_bare_pickle, a_bare_array_of_objects, a_very_deep_json]
