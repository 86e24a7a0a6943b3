"""An exported policy acts in numpy and ONNX Runtime as it does in PyTorch, and refuses what it cannot fly by."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from safetensors.torch import load_file
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from tests.helpers.exported import edit_contract, exported, put_network
from tests.helpers.recorded import READ, SCANNED, SCANS, RecordedScans
from uavrl.config import validate
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.environment import build
from uavrl.evaluation.policies import PACKAGED
from uavrl.evaluation.rollout import rollout
from uavrl.export.simulated import ExportedPolicy
from uavrl.transforms import NavigationState, PointCloudReduction
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.policy.contract import read_contract
from uavrl_onboard.policy.policy import Policy

STATES = 10_000
KINDS = {
    "td3": ("algo=td3", "perception=truncated_icosahedron"),
    "ddpg": ("algo=ddpg", "perception=range_image", "perception.last_action=true", "perception.angles=turns"),
    "sac": ("algo=sac", "perception=truncated_icosahedron", "perception.last_action=true", "perception.radius=3.5"),
    "sac, cells": ("algo=sac", "perception=range_image", "randomize=real", "perception.frames=2"),
    "grid": ("perception=range_image", "perception.grid={columns:12,rows:2,elevation:[-10,20],borders:[4]}"),
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    made: dict[str, Path] = {}

    def folder(kind: str) -> Path:
        if kind not in made:
            made[kind] = exported(tmp_path_factory.mktemp("exported"), "algo.hidden=[16,8]", *KINDS[kind])
        return made[kind]

    return folder


@pytest.fixture
def folder(folders: Callable[[str], Path], tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(folders("ddpg"), tmp_path / "exported"))


def torch_policy(folder: Path) -> Callable[[TensorDictBase], TensorDictBase]:
    return read_policy(folder)


@pytest.mark.parametrize("kind", KINDS)
def test_actions_are_those_of_the_policy_in_10_000_states(kind: str, folders: Callable[[str], Path]) -> None:
    folder = folders(kind)
    policy = Policy(folder)
    states = 2 * torch.randn(STATES, policy.contract.state.size, generator=torch.Generator().manual_seed(1))
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = torch_policy(folder)(TensorDict({"observation": states}, [STATES]))["action"].numpy()
    for number in (STATES, 1):
        actions, _ = policy._network(states[:number].numpy(), policy._network.new_memory(number))
        np.testing.assert_allclose(actions, expected[:number], rtol=0, atol=1e-5)
    assert expected.std(0).min() > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_scans_and_poses_lead_to_the_same_actions(kind: str, folders: Callable[[str], Path]) -> None:
    """Reduction, scaling, frames, padding and last action, of every vehicle its own."""
    folder, scans = folders(kind), load_file(SCANS)
    scans = {key: scans[key] for key in ("cloud", "action", *READ)}
    settings = validate(read_policy(folder).config)
    state = build(settings.perception, NavigationState)
    for part in state.modules():
        if isinstance(part, PointCloudReduction):
            part.del_keys = False
    env = TransformedEnv(RecordedScans(scans), state)
    env.append_transform(InitTracker())
    found = []
    for policy in (torch_policy(folder), ExportedPolicy(folder)):
        for _ in range(2):  # an episode leaves nothing behind
            flown = islice(rollout(env, policy, env.reset()), SCANNED - 1)
            found.append(torch.stack([step["action"] for step in flown]).numpy())
    np.testing.assert_allclose(found[2], found[0], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(found[3], found[2])
    assert np.ptp(found[0], axis=(0, 1)).min() > 1e-4


def test_one_vehicle_begins_anew_and_the_others_go_on(folders: Callable[[str], Path]) -> None:
    policy, rng = ExportedPolicy(folders("ddpg")), np.random.default_rng(0)

    def act(begins: list[bool], cloud: torch.Tensor) -> torch.Tensor:
        pose = {key: torch.full((2, 1), 3.0) for key in READ}
        data = {"point_cloud": cloud.expand(2, -1, -1), "is_init": torch.tensor(begins)[:, None], **pose}
        return policy(TensorDict(data, [2]))["action"]

    first, second = torch.from_numpy(rng.uniform(-3, 3, (2, 50, 3)))
    once = act([True, True], first)
    assert torch.equal(once[0], once[1])
    later = act([True, False], second)
    assert not torch.equal(later[0], later[1])
    assert torch.equal(act([True, True], first), once)


def test_a_cloud_of_the_blind_is_empty_whatever_comes(folder: Path) -> None:
    seen = Policy(folder)(np.array([[1.0, 0.0, 0.0]]), 3.0, 0.0, 0.0)
    edit_contract(folder, lambda terms: terms["cloud"].update(blind=True))
    blind = Policy(folder)
    answers = [blind.copy()(np.array([point]), 3.0, 0.0, 0.0) for point in ([1.0, 0.0, 0.0], [np.nan] * 3)]
    np.testing.assert_array_equal(*answers)
    assert not np.array_equal(answers[0], seen)


def test_what_is_no_scan_and_no_pose_is_refused_and_changes_nothing(folder: Path) -> None:
    policy, other, cloud = Policy(folder), Policy(folder), np.full((1, 3), np.nan)
    for bad, told in [
        ((cloud, np.nan, 0.0, 0.0), "must be finite numbers"),
        ((cloud, 3.0, np.inf, 0.0), "must be finite numbers"),
        ((np.zeros((4, 2)), 3.0, 0.0, 0.0), r"points must be an array of floats \[P, 3\]"),
        ((np.zeros((1, 3), int), 3.0, 0.0, 0.0), r"points must be an array of floats"),
    ]:
        with pytest.raises(UavrlError, match=told):
            policy(*bad)
    np.testing.assert_array_equal(policy(cloud, 3.0, 0.0, 0.0), other(cloud, 3.0, 0.0, 0.0))


# ---------------------------------------------------------------------- folders that somebody sent


def network(*nodes: Any, weights: Any = (), width: int = 237) -> bytes:
    """A graph of one's own from ``state`` to ``action``."""
    ends = [helper.make_tensor_value_info(*end) for end in (("state", 1, ["n", width]), ("action", 1, ["n", 4]))]
    graph = helper.make_graph(list(nodes), "g", ends[:1], ends[1:], list(weights))
    opset = [helper.make_opsetid("", 18), helper.make_opsetid("own", 1)]
    return helper.make_model(graph, opset_imports=opset, ir_version=10).SerializeToString()


def product(weights: TensorProto, width: int = 237) -> bytes:
    return network(helper.make_node("MatMul", ["state", "w"], ["action"]), weights=[weights], width=width)


def elsewhere() -> TensorProto:
    """Weights that lie in another file."""
    weights = TensorProto(name="w", data_type=1, dims=[237, 4], data_location=TensorProto.EXTERNAL)
    for key, value in (("location", "secret.bin"), ("offset", "0"), ("length", "3792")):
        weights.external_data.add(key=key, value=value)
    return weights


def full(value: float, width: int = 237) -> TensorProto:
    return onnx.numpy_helper.from_array(np.full((width, 4), value, np.float32), "w")


def changed(*path: Any, to: Any) -> Callable[[Path], None]:
    """Puts a value at a place of the contract."""

    def change(terms: Any) -> None:
        *above, last = path
        for key in above:
            terms = terms[key]
        terms[last] = to

    return lambda folder: edit_contract(folder, change)


def cut(name: str, length: int) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:length])


def written(name: str, content: bytes) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_bytes(content)


def replaced(content: Callable[[], bytes]) -> Callable[[Path], None]:
    return lambda folder: put_network(folder, content())


def truncated_with_its_checksum(folder: Path) -> None:
    put_network(folder, (folder / "policy.onnx").read_bytes()[:900])


DAMAGES: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no contract": (
        lambda folder: (folder / "contract.json").unlink(),
        "contract.json and found no such file: write one by uavrl-export policy=best output=FOLDER",
    ),
    "no network": (lambda folder: (folder / "policy.onnx").unlink(), "policy.onnx and found no such file"),
    "cut contract": (cut("contract.json", 100), "contract.json is damaged (its text: "),
    "no json": (written("contract.json", b"\xff\x00"), "contract.json is damaged"),
    "a list": (written("contract.json", b"[]"), "contract.json is damaged"),
    "deep json": (written("contract.json", b"[" * 100_000), "contract.json is damaged"),
    "huge json": (written("contract.json", b" " * 2_000_000), "has more than 1,048,576 bytes"),
    "another format": (changed("format", to="other"), "is not of uavrl.contract 1"),
    "another version": (changed("version", to=2), "is not of uavrl.contract 1"),
    "missing key": (lambda folder: edit_contract(folder, lambda terms: terms.pop("cells")), "(cells: Field required)"),
    "missing size": (
        lambda folder: edit_contract(folder, lambda terms: terms["state"].pop("frames")),
        "(state.frames: Field required)",
    ),
    "no network named": (
        lambda folder: edit_contract(folder, lambda terms: terms.pop("network")),
        "names no policy.onnx: pip install 'uavrl[export]'",
    ),
    "another file": (changed("network", "file", to="../policy.onnx"), "names no policy.onnx"),
    "NaN": (changed("observation", 1, "divisor", to=float("nan")), "observation.1.divisor: Input should be a finite"),
    "infinite limit": (changed("action", "high", to=[float("inf")] * 4), "action.high.0: Input should be a finite"),
    "divided by 0": (
        changed("observation", 1, "divisor", to=0.0),
        "observation.1.divisor: Input should be greater than 0",
    ),
    "text": (changed("rate_hz", to="10"), "rate_hz: Input should be a valid number"),
    "huge frames": (changed("state", "frames", to=10**12), "state.frames: Input should be less than or equal to 1000"),
    "huge count": (changed("cells", "count", to=10**9), "cells.count: Input should be less than or equal to 10000"),
    "another count": (changed("cells", "count", to=71), "cells are not those of range_image"),
    "another reduction": (
        changed("cells", "reduction", to="truncated_icosahedron"),
        "cells are not those of truncated",
    ),
    "unknown reduction": (changed("cells", "reduction", to="octree"), "cells.reduction: Input should be "),
    "turned cells": (changed("cells", "directions", 0, to=[0.0, 1.0, 0.0]), "cells are not those of range_image"),
    "another radius": (changed("cells", "radius", to=5.0), "is not that of a radius of 5 m"),
    "no radius": (changed("cells", "radius", to=-4.0), "cells.radius: Input should be greater than 0.05"),
    "other middles": (changed("cells", "offsets", 0, to=3.0), "cells.offsets is not that of a radius of 4 m"),
    "no grid": (
        lambda folder: edit_contract(folder, lambda terms: terms["cells"].pop("columns")),
        "cells are not those",
    ),
    "another miss": (changed("cloud", "squared_range", to=[0.0, 16.0]), "is not that of a radius of 4 m"),
    "another width": (changed("state", "size", to=236), "state.size is not state.frames times"),
    "wide entry": (changed("observation", 1, "size", to=2), "observation has other quantities or scales"),
    "twice": (changed("observation", 2, "name", to="altitude"), "observation has other quantities or scales"),
    "unknown quantity": (changed("observation", 2, "name", to="speed"), "observation.2.name: Input should be "),
    "other order": (changed("action", "order", to=["a_z", "l_x", "l_y", "l_z"]), "action.order is not l_x, l_y"),
    "other scale": (changed("observation", 3, "shift", to=1.0), "observation has other quantities or scales"),
    "other scale of the cells": (changed("observation", 0, "divisor", to=1.0), "observation has other quantities"),
    "padded by 1": (changed("state", "padding", to=1), "state.padding: Input should be 0"),
    "no limits": (changed("action", "low", to=[2.0] * 4), "action.low is not below action.high"),
    "flipped bit": (
        written("policy.onnx", b"no network"),
        "policy.onnx is damaged, or of another policy than contract",
    ),
    "cut network": (cut("policy.onnx", 500), "its checksum differs"),
    "cut network with its checksum": (truncated_with_its_checksum, "is no network that ONNX Runtime opens"),
    "no onnx": (replaced(lambda: b"no network"), "is no network that ONNX Runtime opens"),
    "another input": (
        changed("network", "input", to="observation"),
        "which is not what contract.json says",
    ),
    "narrow network": (
        replaced(lambda: product(full(1.0, 7), width=7)),
        "('state', 'tensor(float)', [7])",
    ),
    "own operator": (
        replaced(lambda: network(helper.make_node("Run", ["state"], ["action"], domain="own"))),
        "is no network that ONNX Runtime opens",
    ),
    "weights elsewhere": (replaced(lambda: product(elsewhere())), "has its numbers in another file"),
    "answers NaN": (replaced(lambda: product(full(float("nan")))), "not finite: do not fly it"),
    "no action for each state": (
        replaced(
            lambda: network(
                helper.make_node("ReduceSum", ["state", "axes"], ["sum"], keepdims=1),
                helper.make_node("Expand", ["sum", "shape"], ["action"]),
                weights=[helper.make_tensor("axes", 7, [2], [0, 1]), helper.make_tensor("shape", 7, [2], [1, 4])],
            )
        ),
        "gives (1, 4) for 3 states",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_folder_that_cannot_be_flown_is_refused_in_a_sentence(name: str, folder: Path, capfd: Any) -> None:
    damage, told = DAMAGES[name]
    (folder / "secret.bin").write_bytes(bytes(3792))
    damage(folder)
    with pytest.raises(UavrlError) as caught:
        Policy(folder)
    sentence = str(caught.value)
    assert told in sentence and str(folder) in sentence and "\n" not in sentence and len(sentence) < 500
    assert capfd.readouterr() == ("", "")


def test_one_without_onnx_runtime_says_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(UavrlError, match=r"needs onnxruntime: pip install 'uavrl-onboard\[onnx\]'"):
        Policy(folder)


@pytest.mark.parametrize(("runtime", "library", "refused"), [("1.18.1", "2.0.0", True), ("1.18.1", "1.26.4", False)])
def test_an_onnx_runtime_of_numpy_1_is_refused_with_numpy_2(
    runtime: str, library: str, refused: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onnxruntime.__version__", runtime)
    monkeypatch.setattr(np, "__version__", library)
    if not refused:
        Policy(folder)
        return
    with pytest.raises(UavrlError, match=rf"ONNX Runtime {runtime} does not work with NumPy {library}: pip install"):
        Policy(folder)


def test_the_simulator_flies_at_its_own_rate_alone(folder: Path) -> None:
    edit_contract(folder, lambda terms: terms.update(rate_hz=20))
    with pytest.raises(UavrlError, match="acts 20 times a second, and the simulator asks 10 times"):
        ExportedPolicy(folder)


@pytest.mark.parametrize(
    "change",
    [
        lambda terms: terms["cloud"].update(blind=True),
        lambda terms: terms.update(rate_hz=5.0),
        lambda terms: terms["observation"][1].update(divisor=35.0),
        lambda terms: terms["cloud"].update(sensor_position=[0.0, 0.0, -5.0]),
        lambda terms: terms["action"].update(high=[20.0] * 4),
    ],
    ids=["blind", "rate", "flight level", "sensor", "limits"],
)
def test_a_sound_contract_that_is_not_the_exported_one_is_refused(change: Callable[[Any], Any], tmp_path: Path) -> None:
    path = exported(tmp_path, "algo.hidden=[8]") / "contract.json"
    terms = json.loads(path.read_text())
    path.write_text(json.dumps(terms, indent=4))  # another layout is no change
    Policy(path.parent)
    change(terms)
    path.write_text(json.dumps(terms))
    with pytest.raises(
        UavrlError, match="was changed after its export, as its checksum differs: export the policy again"
    ):
        Policy(path.parent)


def test_a_whole_number_that_no_float_holds_is_refused(tmp_path: Path) -> None:
    terms = json.loads((PACKAGED / "best" / "contract.json").read_text())
    terms["guards"]["map"]["every"] = 10**400
    del terms["sha256"]
    (tmp_path / "contract.json").write_text(json.dumps(terms))
    with pytest.raises(UavrlError, match=r"guards.map.every"):
        read_contract(tmp_path)
