"""Whether a term that rests on a learned model counts yet."""

import math

import torch
from torch import Tensor, nn


class Gate(nn.Module):
    """Open while the last loss of a model was under a threshold.

    It lies on the device, since ``torch.compile`` breaks a graph that takes a number off it: there the gate always
    says that it is open, and :meth:`mask` does what a branch would. No state dict holds it: its owner saves it.

    Examples:
        >>> gate = Gate(threshold=0.1)
        >>> gate.update(0.05), gate.is_open
        (None, True)
    """

    state: Tensor

    def __init__(self, threshold: float, device: torch.device | None = None) -> None:
        super().__init__()
        self.threshold = threshold
        # Whether it is open, the last losses, and how many of how many updates left it open.
        state = torch.tensor([0.0, math.nan, math.nan, 0.0, 0.0], dtype=torch.float64, device=device)
        self.register_buffer("state", state, persistent=False)
        self._open: bool | None = False  # the first of them, None until somebody asks

    @property
    def is_open(self) -> bool:
        """Whether the last loss was under the threshold."""
        if torch.compiler.is_compiling():
            return True
        if self._open is None:
            self._open = bool(self.state[0])
        return self._open

    def mask(self, value: Tensor, otherwise: Tensor | float) -> Tensor:
        """The value; in a compiled graph only while the gate is open."""
        return torch.where(self.state[0] > 0, value, otherwise) if torch.compiler.is_compiling() else value

    @torch.no_grad()
    def update(self, loss: Tensor | float, other: Tensor | float = math.nan) -> None:
        """Opens or closes by a model's loss; another one is kept to be shown."""
        state = self.state
        state[1], state[2] = loss, other
        state[0] = state[1] < self.threshold
        state[3] += state[0]
        state[4] += 1
        self._open = None if torch.compiler.is_compiling() else bool(state[0])

    def load(self, state: Tensor) -> None:
        """Takes over the state of another."""
        self.state.copy_(state)
        self._open = None

    def close(self) -> None:
        """Closes until the next update; what was counted stays."""
        self.state[0], self.state[1:3], self._open = 0.0, math.nan, False

    def take(self) -> tuple[float, float, float]:
        """The share of updates since the last call that left it open, and the last losses."""
        is_open, loss, other, openings, updates = self.state.tolist()
        self.state[3:] = 0.0
        return openings / updates if updates else is_open, loss, other
