"""The networks of ABR⁺ (Chansuparp (2022), §3.3): the Siamese autoencoder, and the classifier of trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.models.actor_critic import as_weights, mlp
from uavrl.runs.weights import ARTIFACT

# Keys of a perception that leave the meaning of a state's numbers alone: how good the sensor is, which bodies it does
# not see, and from where altitude is counted.
_NOT_COMPARED = ("lidar", "blind_to", "flight_level")


class PSAE(nn.Module):
    """The all-positive Siamese autoencoder: ``inputs``-``hidden``-``features``-``hidden``-``inputs`` (Figure 3.3).

    ReLU follows the hidden layers alone: the features are linear, so that their cosine similarity has all of
    [-1, 1] to itself and no feature can die. The Siamese part is in the loss, which sends three states through
    the one network.

    Args:
        inputs: width of a state.
        features: width of the latent space (Table 4.1: 20).
        hidden: width of the hidden layers (the thesis gives none).

    Examples:
        >>> network = PSAE()
        >>> features, reconstruction = network(torch.zeros(7, 105))
        >>> features.shape, reconstruction.shape, network.encode(torch.zeros(105)).shape
        (torch.Size([7, 20]), torch.Size([7, 105]), torch.Size([20]))
    """

    def __init__(self, inputs: int = 105, features: int = 20, hidden: int = 64) -> None:
        super().__init__()
        self.inputs = inputs
        self.encoder = mlp(inputs, [hidden], features)
        self.decoder = mlp(features, [hidden], inputs)

    def encode(self, states: Tensor) -> Tensor:
        """States ``[*B, inputs]`` to features ``[*B, features]``."""
        return self.encoder(as_weights(states, self.encoder[0].weight))

    def forward(self, states: Tensor) -> tuple[Tensor, Tensor]:
        """States ``[*B, inputs]`` to features ``[*B, features]`` and reconstructions ``[*B, inputs]``."""
        features = self.encode(states)
        return features, self.decoder(features)


class TrajectoryClassifier(nn.Module):
    """States to classes: PSAE's encoder, a fixed scaling of its features, and a network from features to classes.

    Args:
        inputs: width of a state.
        features: width of the latent space.
        hidden: width of the encoder's hidden layer.
        classifier_hidden: widths of the classifier's hidden layers.
        k: number of classes.

    Attributes:
        perception: the keys of the perception that decide what its states mean, with their values; empty
            where that is not known.

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
        self.perception: dict[str, Any] = {}
        sizes = {"inputs": inputs, "features": features, "hidden": hidden}
        self.sizes = {**sizes, "classifier_hidden": list(classifier_hidden), "k": k}
        self.encoder = mlp(inputs, [hidden], features)
        self.classifier = mlp(features, classifier_hidden, k)
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))
        self.register_buffer("centres", torch.zeros(k, features))

    @torch.no_grad()
    def encode(self, states: Tensor) -> Tensor:
        """States ``[*B, inputs]`` to scaled features ``[*B, features]``; UavrlError for states of another width."""
        if states.shape[-1:] != (self.inputs,):
            raise UavrlError(f"Expected states [*B, {self.inputs}], got {list(states.shape)}: use another artifact.")
        return (self.encoder(as_weights(states, self.mean)) - self.mean) / self.scale

    @torch.no_grad()
    def forward(self, states: Tensor) -> Tensor:
        """The class ``[*B]`` (int64, from 0) of each state ``[*B, inputs]``; UavrlError as in :meth:`encode`."""
        return self.classifier(self.encode(states)).argmax(-1)

    def save(self, path: Path, report: Mapping[str, Any]) -> dict[str, Any]:
        """Writes an artifact into an existing folder; returns the content of ``artifact.json``, with the report's."""
        return ARTIFACT.save(path, self.state_dict(), {"sizes": self.sizes, "perception": self.perception, **report})

    @classmethod
    def load(cls, path: str | Path) -> TrajectoryClassifier:
        """Loads the artifact that ``uavrl-pretrain`` wrote into a folder; nothing in it is unpickled.

        Raises:
            UavrlError: when it is missing, of another format or version, or damaged.
        """
        about, weights = ARTIFACT.load(Path(path))
        try:
            with torch.device("meta"):  # takes no memory, whatever sizes are named
                expected = {name: tensor.shape for name, tensor in cls(**about["sizes"]).state_dict().items()}
            if expected != {name: tensor.shape for name, tensor in weights.items()}:
                raise ValueError("its sizes are not those of its weights")
            classifier = cls(**about["sizes"])
            classifier.load_state_dict(weights)
            classifier.perception = about.get("perception", {})
            if not isinstance(classifier.perception, dict):
                raise ValueError("its perception is no mapping")
        except Exception as error:
            reason = str(error).splitlines()[0]
            raise UavrlError(f"The artifact {path} is damaged ({reason}): {ARTIFACT.remedy}.") from error
        return classifier.float().requires_grad_(False).eval()  # as it was saved, whatever the host's default is


def form_of_states(perception: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a perception that decide what each number of a state means.

    Examples:
        >>> form_of_states({"angles": "raw", "frames": 3, "flight_level": 3.5})
        {'angles': 'raw', 'frames': 3}
    """
    return {key: value for key, value in perception.items() if key not in _NOT_COMPARED}


def packaged_artifact(name: str = "abr_plus_static") -> Path:
    """The folder of an artifact that comes with the package."""
    path = Path(__file__).resolve().parent.parent / "artifacts" / name
    if not ARTIFACT.is_in(path):
        raise UavrlError(f"Expected the artifact {name} in {path} and found none: {ARTIFACT.remedy}.")
    return path
