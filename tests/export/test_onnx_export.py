"""policy.onnx: the same file everywhere, of any network that PyTorch can export, or a sentence that says why not."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx.reference import ReferenceEvaluator
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from tests.helpers.commands import content
from tests.helpers.exported import exported, policy_folder
from uavrl.errors import UavrlError
from uavrl.export.export import export_policy
from uavrl.export.onnx_export import opset_of, policy_onnx
from uavrl.models import Actor

SMALL = ("algo.hidden=[4]",)


def export_network(network: nn.Module) -> bytes:
    return policy_onnx(TensorDictModule(network, ["observation"], ["action"]), 6, [-2.0] * 4, [2.0] * 4)


def acted(file: bytes, states: Tensor) -> np.ndarray:
    (actions,) = ReferenceEvaluator(onnx.load_from_string(file)).run(["action"], {"state": states.numpy()})
    return actions


class Branching(nn.Module):
    """Chooses by its input, which no graph can."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Linear(6, 4)

    def forward(self, state: Tensor) -> Tensor:
        return self.net(state) if float(state.sum()) > 0 else -self.net(state)


class Noisy(Branching):
    def forward(self, state: Tensor) -> Tensor:
        return self.net(state) + torch.randn(len(state), 4)


class Convolving(Branching):
    """A convolution over six numbers, a norm and dropout."""

    def __init__(self) -> None:
        super().__init__()
        self.convolved = nn.Conv1d(1, 2, 3)
        self.rest = nn.Sequential(nn.LayerNorm(8), nn.Dropout(0.5), nn.SiLU(), nn.Linear(8, 4))

    def forward(self, state: Tensor) -> Tensor:
        return self.rest(self.convolved(state.unsqueeze(-2)).flatten(-2))


def test_it_is_the_same_file_wherever_it_is_made(tmp_path: Path) -> None:
    file = (exported(tmp_path / "here", *SMALL) / "policy.onnx").read_bytes()
    assert (exported(tmp_path / "there", *SMALL) / "policy.onnx").read_bytes() == file
    model = onnx.load_from_string(file)
    onnx.checker.check_model(model, full_check=True)
    for place in (str(tmp_path), str(Path(__file__).parents[2]), "site-packages", ".py", "uavrl"):
        assert place.encode() not in file, place
    parts = [model, *model.graph.node, *model.graph.input, *model.graph.output, *model.graph.initializer]
    assert not any(part.metadata_props for part in parts)


class Choosing(Branching):
    """Chooses within the graph, which holds a graph for each of its answers."""

    def forward(self, state: Tensor) -> Tensor:
        return torch.cond(
            state.sum() > 0, lambda x: self.net(x).relu(), lambda x: nn.functional.silu(-x[..., :4]), (state,)
        )


@pytest.mark.parametrize(
    ("network", "opset", "version"),
    [
        (lambda: nn.Sequential(nn.Linear(6, 8), nn.ReLU(), nn.Linear(8, 4), nn.Tanh()), 14, 7),
        (lambda: nn.Sequential(nn.Linear(6, 4), nn.Tanh()), 13, 7),
        (Convolving, 17, 8),
        (Choosing, 16, 8),
    ],
    ids=["as TD3", "tanh alone", "layer norm", "a graph in the graph"],
)
def test_old_versions_of_onnx_runtime_open_it(network: Callable[[], nn.Module], opset: int, version: int) -> None:
    """ONNX Runtime 1.16 reads IR version 9 at most, and PyTorch writes 10."""
    torch.manual_seed(0)
    made = network()
    file = export_network(made)
    assert (opset_of(file), onnx.load_from_string(file).ir_version) == (opset, version)
    states = torch.randn(9, 6, generator=torch.Generator().manual_seed(1))
    np.testing.assert_allclose(acted(file, states), made.eval()(states).clamp(-2, 2).detach().numpy(), atol=1e-5)


def test_actions_are_cut_to_their_limits() -> None:
    network = nn.Linear(6, 4)
    states = 20 * torch.randn(50, 6, generator=torch.Generator().manual_seed(0))
    actions = acted(export_network(network), states)
    assert actions.min() == -2.0 and actions.max() == 2.0
    np.testing.assert_allclose(actions, network(states).clamp(-2, 2).detach().numpy(), atol=1e-5)


def test_a_network_of_ones_own_acts_as_it_does_when_it_is_evaluated() -> None:
    torch.manual_seed(0)
    network = Convolving()
    states = torch.randn(3, 6)
    actions = acted(export_network(network), states)
    assert network.training and network.rest[1].training, "it is left as it was"
    np.testing.assert_allclose(actions, network.eval()(states).detach().numpy(), atol=1e-5)


@pytest.mark.parametrize(
    ("network", "told"),
    [
        (Branching, "PyTorch cannot export the policy's network ("),
        (Noisy, "what PyTorch exported acts otherwise than the policy, by up to "),
    ],
)
def test_a_network_that_has_no_such_file_is_told_of_in_a_sentence(
    network: type[nn.Module], told: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UavrlError) as caught:
        export_network(network())
    sentence = str(caught.value)
    assert sentence.startswith("policy.onnx is left out: ") and told in sentence
    assert "\n" not in sentence and len(sentence) < 400
    assert capfd.readouterr() == ("", "")


def test_exporting_draws_nothing() -> None:
    network = Actor(6, 4, (4,))
    before = torch.get_rng_state()
    export_network(network)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("missing", ["onnx", "onnxscript"])
def test_without_the_extra_the_rest_is_written_and_a_hint_given(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: Any
) -> None:
    folder = policy_folder(tmp_path / "own", *SMALL)
    monkeypatch.setitem(sys.modules, missing, None)
    export_policy(folder, None, tmp_path / "exported")
    assert set(content(tmp_path / "exported")) == {
        *("README.md", "config.yaml", "contract.json", "policy.json", "policy.safetensors")
    }
    assert '"network"' not in (tmp_path / "exported/contract.json").read_text()
    (record,) = caplog.records
    assert f"it needs {missing}. To have it, pip install 'uavrl[export]' and export again" in record.getMessage()
