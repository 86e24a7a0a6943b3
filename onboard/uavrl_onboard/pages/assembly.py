"""Pages that need no network: their data, their programs and plotly's inside."""

import base64
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from uavrl_onboard.libraries import needed


def needs_plotly() -> str:
    """Returns plotly's JavaScript, which goes into the page."""
    script: str = needed("plotly.offline", "A page", "pages").get_plotlyjs()
    return script


def pack(values: np.ndarray, scale: float | None = None) -> dict[str, Any]:
    """An array as JSON: little-endian bytes in base64."""
    values = np.asarray(values)
    if scale is not None:
        kind, stored = "i2", np.round(values / scale)
    else:
        kind, stored = ("i4", values) if np.issubdtype(values.dtype, np.integer) else ("f4", values)
    data = base64.b64encode(np.ascontiguousarray(stored.astype(f"<{kind}")).tobytes()).decode()
    return {"type": kind, "shape": list(values.shape), **({} if scale is None else {"scale": scale}), "data": data}


def filled(name: str, parts: Sequence[str], data: dict[str, Any], *, package: str = __name__) -> str:
    """A page with its parts, plotly and ``data`` in the places that it has for them.

    Page and parts lie in the ``assets`` beside the module ``package``, or in those of this room.
    """
    folders = [resources.files(each.rpartition(".")[0]) / "assets" for each in (package, __name__)]
    sources = (next(folder / file for folder in folders if (folder / file).is_file()) for file in (name, *parts))
    page, *texts = (each.read_text(encoding="utf-8") for each in sources)
    content = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    # No fragment holds another one's mark, so the order of the replacements does not matter.
    for mark, text in zip((*parts, "plotly.js", "data.json"), (*texts, needs_plotly(), content), strict=True):
        before, found, after = page.partition(f"/*{mark}*/")
        assert found, f"{name} has no place for {mark}"
        page = before + text + after
    return page
