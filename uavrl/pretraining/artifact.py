"""Writing the artifact that :class:`uavrl.models.trajectory_classifier.TrajectoryClassifier` loads."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uavrl.errors import UavrlError
from uavrl.files import replacing
from uavrl.models.trajectory_classifier import ABOUT, FORMAT, VERSION, WEIGHTS, TrajectoryClassifier


def make_output(output: Path) -> None:
    """Makes the artifact's folder, before anything is computed.

    Raises:
        UavrlError: when it cannot be written, or holds an artifact already.
    """
    if (output / ABOUT).exists() or (output / WEIGHTS).exists():
        raise UavrlError(f"The folder {output} holds an artifact already: choose another with output=FOLDER.")
    try:
        output.mkdir(parents=True, exist_ok=True)
        partial = output / f"{ABOUT}.partial"
        partial.unlink(missing_ok=True)  # it may be a link to somewhere else
        partial.touch()
        partial.unlink()
    except OSError as error:
        raise UavrlError(
            f"{output} cannot be written ({error.strerror}): choose another with output=FOLDER."
        ) from error


def save_artifact(output: Path, classifier: TrajectoryClassifier, report: Mapping[str, Any]) -> dict[str, Any]:
    """Writes ``artifact.safetensors`` and then ``artifact.json``; an artifact without the latter does not load.

    Args:
        output: the folder.
        classifier: what is saved.
        report: what else ``artifact.json`` tells.

    Returns:
        What ``artifact.json`` holds.
    """
    from safetensors.torch import save

    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in classifier.state_dict().items()}
    content = save(weights)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "sizes": classifier.sizes,
        "shapes": {name: list(tensor.shape) for name, tensor in weights.items()},
        "weights_sha256": hashlib.sha256(content).hexdigest(),
        **report,
    }
    with replacing(output / WEIGHTS) as partial:
        partial.write_bytes(content)
    with replacing(output / ABOUT) as partial:
        partial.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    return about


def sha256_of_states(states: np.ndarray) -> str:
    """The checksum of states ``[N, width]`` as float32, little endian.

    Examples:
        >>> sha256_of_states(np.zeros((2, 3)))[:12]
        '9d908ecfb6b2'
    """
    digest = hashlib.sha256()
    for start in range(0, len(states), 100_000):
        digest.update(np.ascontiguousarray(states[start : start + 100_000], "<f4").tobytes())
    return digest.hexdigest()


def sha256_of_config(config: Mapping[str, Any]) -> str:
    """The checksum of a plain configuration, whatever the order of its keys.

    Examples:
        >>> sha256_of_config({"a": 1, "b": 2}) == sha256_of_config({"b": 2, "a": 1})
        True
    """
    return hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()
