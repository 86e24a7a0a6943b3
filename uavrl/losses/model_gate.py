"""Whether a learned model is good enough for the actor to use."""

import math

import torch
from torch import Tensor, nn


class ModelGate(nn.Module):
    """Open while the last loss of a model was under a threshold.

    Its state stays on the device, since ``torch.compile`` breaks a graph that reads a number from it: there
    :attr:`is_open` is always true, and :meth:`mask` replaces the branch. No state dict holds the state; its owner does.

    Examples:
        >>> gate = ModelGate(threshold=0.1)
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
        self._open: bool | None = False  # the first of them; None: to be read from the device

    @property
    def is_open(self) -> bool:
        """Whether the last loss was under the threshold; always true in a compiled graph."""
        if torch.compiler.is_compiling():
            return True
        if self._open is None:
            self._open = bool(self.state[0])
        return self._open

    def mask(self, value: Tensor, otherwise: Tensor | float) -> Tensor:
        """The value; in a compiled graph ``otherwise`` while the gate is closed."""
        return torch.where(self.state[0] > 0, value, otherwise) if torch.compiler.is_compiling() else value

    @torch.no_grad()
    def update(self, loss: Tensor | float, other: Tensor | float = math.nan) -> None:
        """Opens or closes by a model's loss; another loss is only kept for :meth:`take`."""
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
        """Closes until the next update; the counts stay."""
        self.state[0], self.state[1:3], self._open = 0.0, math.nan, False

    def take(self) -> tuple[float, float, float]:
        """The share of updates since the last call that left the gate open, and the last losses."""
        is_open, loss, other, openings, updates = self.state.tolist()
        self.state[3:] = 0.0
        return openings / updates if updates else is_open, loss, other
