from __future__ import annotations

import logging
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.training.compiled import Execution, Gradients, LossGradients, chosen_execution

RECORDING: list[Execution] = ["captured", pytest.param("compiled", marks=pytest.mark.slow)]


class Noisy(nn.Module):
    """Σ (scale w x + ε - 1)² with fresh noise ε at each call; counts how often its Python code runs."""

    scale: Tensor

    def __init__(self, noise: float = 0.0) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor([1.0, -2.0, 0.5]))
        self.register_buffer("scale", torch.tensor(1.5))
        self.noise = noise
        self.squared = True
        self.calls = 0

    def forward(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        self.calls += 1
        errors = self.scale * self.weight * batch["x"] + self.noise * torch.randn_like(batch["x"]) - 1
        if "shift" in batch.keys():  # noqa: SIM118
            errors = errors + batch["shift"]
        loss = errors.square().sum() if self.squared else errors.sum()
        return loss, {"errors": errors, "size": errors.abs().amax()}


def gradients_of(loss: Noisy, execution: Execution) -> LossGradients:
    return LossGradients(loss, [loss.weight], execution, ["x", "shift"], lambda: loss.squared)


def data(size: int = 4, **more: Tensor) -> TensorDict:
    return TensorDict({"x": torch.arange(3.0 * size).reshape(size, 3) / 5, **more}, [size])


def by_hand(loss: Noisy, batch: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Loss and gradient without noise."""
    x, w, s = batch["x"], loss.weight.detach(), loss.scale
    errors = s * w * x - 1 + batch.get("shift", torch.zeros(()))
    if loss.squared:
        return errors.square().sum(), (2 * errors * s * x).sum(0)
    return errors.sum(), (s * x).sum(0)


def check(gradients: LossGradients, loss: Noisy, batch: TensorDictBase) -> Gradients:
    result = gradients(batch)
    value, gradient = by_hand(loss, batch)
    torch.testing.assert_close(result.loss, value.to(result.loss))
    torch.testing.assert_close(result.gradients[0], gradient.to(loss.weight))
    return result


def test_another_execution_is_refused() -> None:
    with pytest.raises(UavrlError, match=r"execution must be .* got 'fast'"):
        gradients_of(Noisy(), "fast")  # type: ignore[arg-type]


def test_updates_are_compiled_where_there_are_a_compiler_and_pythons_headers(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    monkeypatch.setenv("CXX", sys.executable)
    assert chosen_execution("auto") == "captured"
    assert f"{tmp_path / 'Python.h'}, which compiling needs, was not found" in caplog.text
    (tmp_path / "Python.h").touch()
    assert chosen_execution("auto") == "compiled"
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert chosen_execution("auto") == "captured"
    assert chosen_execution("eager") == "eager"


def test_what_cannot_be_compiled_is_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("no compiler\nand a long story")

    monkeypatch.setattr("torch._inductor.compile", broken)
    monkeypatch.setattr("uavrl.training.compiled.log.warning", lambda text, *values: said.append(text % values))
    loss = Noisy()
    check(gradients_of(loss, "compiled"), loss, data())
    assert said == ["The update could not be compiled (no compiler): it is captured instead, which is slower."]


@pytest.mark.parametrize("execution", ["eager", *RECORDING])
def test_results_are_those_by_hand_and_detached(execution: Execution) -> None:
    loss = Noisy()
    result = check(gradients_of(loss, execution), loss, data())
    assert sorted(result.metadata) == ["errors", "size"]
    torch.testing.assert_close(result.metadata["size"], result.metadata["errors"].abs().amax())
    assert not any(value.requires_grad for value in (result.loss, *result.metadata.values(), *result.gradients))
    assert loss.weight.grad is None


@pytest.mark.parametrize("recording", RECORDING)
def test_recording_leaves_the_stream_of_random_numbers_alone(recording: Execution) -> None:
    """Recorded at the first call, at a new size and in a new mode: the numbers are always those of eager code."""
    streams: dict[str, list[Tensor]] = {}
    executions: tuple[Execution, ...] = ("eager", recording)
    for execution in executions:
        loss = Noisy(noise=1.0)
        gradients = gradients_of(loss, execution)
        torch.manual_seed(3)
        seen: list[Tensor] = [torch.rand(2)]
        for size, squared in ((4, True), (4, True), (7, True), (4, False), (4, True), (7, False)):
            loss.squared = squared
            result = gradients(data(size))
            seen += [result.loss, result.metadata["errors"], *result.gradients, torch.rand(2)]
        streams[execution] = seen
        assert loss.calls == (6 if execution == "eager" else 4)
    last_digits = 1e-6 if recording == "compiled" else 0.0
    torch.testing.assert_close(streams["eager"], streams[recording], rtol=last_digits, atol=last_digits)


@pytest.mark.parametrize("execution", ["eager", *RECORDING])
def test_noise_is_fresh_at_each_call(execution: Execution) -> None:
    gradients = gradients_of(Noisy(noise=1.0), execution)
    losses = [gradients(data()).loss.item() for _ in range(4)]
    assert len(set(losses)) == 4


@pytest.mark.parametrize("execution", RECORDING)
def test_the_loss_runs_once_for_each_batch_size_mode_and_set_of_entries(execution: Execution) -> None:
    loss = Noisy()
    gradients = gradients_of(loss, execution)
    shifted = data(shift=torch.full((4, 3), 0.5))
    for calls, batches in ((3, [data(size) for size in (4, 4, 6, 4, 6, 1)]), (4, [data(), shifted, data(), shifted])):
        for batch in batches:
            assert check(gradients, loss, batch).metadata["errors"].shape == batch["x"].shape
        assert loss.calls == calls
    for squared in (True, False, True, False):
        loss.squared = squared
        check(gradients, loss, data())
    assert loss.calls == 5


@pytest.mark.parametrize("execution", RECORDING)
def test_changes_in_place_are_seen(execution: Execution) -> None:
    """Of parameters, of buffers, by an optimiser and by loading a state."""
    loss = Noisy()
    gradients = gradients_of(loss, execution)
    optimizer = torch.optim.Adam([loss.weight], lr=0.3, fused=True)

    def step() -> None:
        loss.weight.grad = gradients(data()).gradients[0]
        optimizer.step()

    changes: list[Callable[[], object]] = [
        lambda: None,
        lambda: loss.weight.data.mul_(2.0),
        lambda: loss.scale.fill_(-0.7),
        step,
        lambda: loss.load_state_dict({"weight": torch.tensor([3.0, 0.0, 1.0]), "scale": torch.tensor(0.2)}),
    ]
    losses: list[float] = []
    for change in changes:
        change()
        losses.append(check(gradients, loss, data()).loss.item())
    assert len(set(losses)) == len(losses)
    assert loss.calls == 1


@pytest.mark.parametrize("execution", ["eager", *RECORDING])
def test_results_of_an_earlier_call_stay_as_they_are(execution: Execution) -> None:
    loss = Noisy()
    gradients = gradients_of(loss, execution)
    first = gradients(data())
    kept = [first.loss.clone(), first.gradients[0].clone(), first.metadata["errors"].clone()]
    loss.weight.data.mul_(3.0)
    gradients(data() * 2)
    assert all(map(torch.equal, kept, (first.loss, first.gradients[0], first.metadata["errors"])))


def test_the_batch_is_left_alone() -> None:
    loss, batch = Noisy(), data()
    before = batch.clone()
    gradients_of(loss, "captured")(batch)
    assert (batch == before).all()
    assert set(batch.keys()) == {"x"}
