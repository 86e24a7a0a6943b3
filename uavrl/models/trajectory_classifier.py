"""The trained classifier of trajectories (Chansuparp (2022), §3.3) and the artifact that it is loaded from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.models.actor_critic import mlp

FORMAT = "uavrl.trajectory_classifier"
VERSION = 1
ABOUT, WEIGHTS = "artifact.json", "artifact.safetensors"


class TrajectoryClassifier(nn.Module):
    """States to classes: PSAE's encoder, a fixed scaling of its features, and a network from features to classes.

    Args:
        inputs: width of a state.
        features: width of the latent space.
        hidden: width of the encoder's hidden layer.
        classifier_hidden: widths of the classifier's hidden layers.
        k: number of classes.

    Examples:
        >>> classifier = TrajectoryClassifier(k=50)
        >>> labels = classifier(torch.zeros(7, 105))
        >>> labels.shape, labels.dtype
        (torch.Size([7]), torch.int64)
    """

    mean: Tensor
    scale: Tensor
    centres: Tensor

    def __init__(
        self,
        inputs: int = 105,
        features: int = 20,
        hidden: int = 64,
        classifier_hidden: Sequence[int] = (64,),
        k: int = 4000,
    ) -> None:
        super().__init__()
        self.inputs, self.k = inputs, k
        self.sizes = {
            "inputs": inputs,
            "features": features,
            "hidden": hidden,
            "classifier_hidden": list(classifier_hidden),
            "k": k,
        }
        self.encoder = mlp(inputs, [hidden], features)
        self.classifier = mlp(features, classifier_hidden, k)
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))
        self.register_buffer("centres", torch.zeros(k, features))

    @torch.no_grad()
    def encode(self, states: Tensor) -> Tensor:
        """States ``[*B, inputs]`` to scaled features ``[*B, features]``.

        Raises:
            UavrlError: for states of another width.
        """
        if states.shape[-1:] != (self.inputs,):
            raise UavrlError(f"Expected states [*B, {self.inputs}], got {list(states.shape)}: use another artifact.")
        return (self.encoder(states) - self.mean) / self.scale

    @torch.no_grad()
    def forward(self, states: Tensor) -> Tensor:
        """The class ``[*B]`` (int64, from 0) of each state ``[*B, inputs]``.

        Raises:
            UavrlError: for states of another width.
        """
        return self.classifier(self.encode(states)).argmax(-1)

    @classmethod
    def load(cls, path: str | Path) -> TrajectoryClassifier:
        """Loads the artifact that ``uavrl-pretrain`` wrote; nothing in it is unpickled.

        Args:
            path: the artifact's folder.

        Raises:
            UavrlError: when it is missing, of another format or version, or damaged.
        """
        from safetensors.torch import load

        path = Path(path)
        about = read_about(path)
        if not (path / WEIGHTS).is_file():
            raise UavrlError(f"Expected {path / WEIGHTS} and found no such file: copy the whole folder.")
        content = (path / WEIGHTS).read_bytes()
        if hashlib.sha256(content).hexdigest() != about["weights_sha256"]:
            raise _damaged(path, f"{WEIGHTS} has another checksum than {ABOUT} says")
        try:
            weights = load(content)
            with torch.device("meta"):  # takes no memory, whatever sizes are named
                expected = {name: list(tensor.shape) for name, tensor in cls(**about["sizes"]).state_dict().items()}
            found = {name: list(tensor.shape) for name, tensor in weights.items()}
            if expected != found:
                differing = sorted(name for name in expected | found if expected.get(name) != found.get(name))
                raise _damaged(path, f"the shapes of {', '.join(differing)} are not those that {ABOUT} says")
            classifier = cls(**about["sizes"])
            classifier.load_state_dict(weights)
        except UavrlError:
            raise
        except Exception as error:
            raise _damaged(path, str(error).splitlines()[0]) from error
        return classifier.requires_grad_(False).eval()


def read_about(path: str | Path) -> dict[str, Any]:
    """What ``artifact.json`` tells of an artifact: sizes, where its data came from, and how good it is.

    Raises:
        UavrlError: when it is missing, or of another format or version.
    """
    file = Path(path) / ABOUT
    if not file.is_file():
        raise UavrlError(f"Expected an artifact with {file} and found no such file: make one with uavrl-pretrain.")
    try:
        about = json.loads(file.read_text())
        known = about["format"] == FORMAT
    except (ValueError, KeyError, TypeError):
        known = False
    if not known:
        raise UavrlError(f"Expected {file} to be of the format {FORMAT}, it holds something else.")
    if about.get("version") != VERSION:
        raise UavrlError(
            f"Expected an artifact of version {VERSION} in {path}, got version {about.get('version')}: "
            f"make it anew with uavrl-pretrain."
        )
    if not {"sizes", "weights_sha256"} <= set(about):
        raise _damaged(Path(path), f"{ABOUT} does not tell sizes and checksum")
    return about


def packaged_artifact(name: str = "abr_plus_static") -> Path:
    """The folder of an artifact that comes with the package.

    Raises:
        UavrlError: when there is none of that name.
    """
    path = Path(__file__).resolve().parent.parent / "artifacts" / name
    if not (path / ABOUT).is_file():
        raise UavrlError(f"Expected the artifact {name} in {path} and found none: make one with uavrl-pretrain.")
    return path


def _damaged(path: Path, reason: str) -> UavrlError:
    return UavrlError(f"The artifact {path} is damaged ({reason}): copy it again, or make it anew with uavrl-pretrain.")
