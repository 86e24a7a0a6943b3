"""Figures of the documentation, in few bytes."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image


def save(figure: Figure, output: Path) -> None:
    """Saves a figure as a PNG of 64 colours."""
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=100)
    Image.open(drawn).convert("RGB").quantize(64, method=Image.Quantize.MAXCOVERAGE).save(output, optimize=True)
