"""Weights on their own: tensors in ``NAME.safetensors``, and ``NAME.json`` with what they are and their checksum."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavrl.errors import UavrlError
from uavrl.runs.names import CONFIG
from uavrl_onboard.files import replacing

if TYPE_CHECKING:  # reports ask for a policy without torch
    from torch import Tensor

VERSION = 1


@dataclass(frozen=True)
class WeightsFile:
    """One kind of weights, as two files in a folder. Nothing in them is unpickled."""

    name: str  # of both files, without suffix
    format: str  # what the json calls it
    thing: str  # what it is, in a sentence
    remedy: str  # how to come by another one

    @property
    def json(self) -> str:
        """The file that tells what the weights are."""
        return f"{self.name}.json"

    @property
    def safetensors(self) -> str:
        """The file of the weights."""
        return f"{self.name}.safetensors"

    def is_in(self, folder: Path) -> bool:
        """Whether a folder holds weights of this kind."""
        return (folder / self.json).is_file()

    def save(self, folder: Path, weights: Mapping[str, Tensor], about: Mapping[str, Any]) -> dict[str, Any]:
        """Writes the weights and then the json, without which they do not load."""
        from safetensors.torch import save

        plain = {name: tensor.detach().cpu().contiguous() for name, tensor in weights.items()}
        content = save(plain)
        facts = {
            "format": self.format,
            "version": VERSION,
            "shapes": {name: list(tensor.shape) for name, tensor in plain.items()},
            "weights_sha256": hashlib.sha256(content).hexdigest(),
            **about,
        }
        with replacing(folder / self.safetensors) as partial:
            partial.write_bytes(content)
        with replacing(folder / self.json) as partial:
            partial.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        return facts

    def about(self, folder: Path) -> dict[str, Any]:
        """What the json holds."""
        path = folder / self.json
        if not path.is_file():
            raise UavrlError(f"Expected {self.thing} with {path} and found no such file: {self.remedy}.")
        try:
            about = json.loads(path.read_bytes())
            known = (about["format"], about["version"]) == (self.format, VERSION)
        except (ValueError, KeyError, TypeError, RecursionError):
            known = False
        if not known:
            raise UavrlError(
                f"{path} is not of {self.format} {VERSION}, which this version of uavrl reads: {self.remedy}."
            )
        return about

    def load(self, folder: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """What :meth:`save` wrote: the json, and the weights on the CPU."""
        from safetensors import SafetensorError
        from safetensors.torch import load

        about = self.about(folder)
        path = folder / self.safetensors
        if not path.is_file():
            raise UavrlError(f"Expected {path} and found no such file: copy the whole folder.")
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != about.get("weights_sha256"):
            raise UavrlError(f"{path} is damaged (its checksum differs from {self.json}'s): {self.remedy}.")
        try:
            return about, load(content)
        except (SafetensorError, ValueError, KeyError) as error:
            raise UavrlError(f"{path} is damaged ({str(error).splitlines()[0]}): {self.remedy}.") from error


POLICY = WeightsFile("policy", "uavrl.policy", "a policy on its own", "export it again with uavrl-export")
ARTIFACT = WeightsFile("artifact", "uavrl.trajectory_classifier", "an artifact", "make one with uavrl-pretrain")


def require_free(folder: Path) -> None:
    """Refuses a folder to export to that holds a policy or a run; loads no torch."""
    if POLICY.is_in(folder) or (folder / CONFIG).exists():
        raise UavrlError(f"The folder {folder} already contains a policy or a run: choose another with output=FOLDER.")
