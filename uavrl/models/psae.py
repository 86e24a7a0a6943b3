"""The all-positive Siamese autoencoder's network (Chansuparp (2022), §3.3, Figure 3.3): a plain module."""

from torch import Tensor, nn

from uavrl.models.actor_critic import mlp


class PSAE(nn.Module):
    """An autoencoder of states: ``inputs``-``hidden``-``features``-``hidden``-``inputs``.

    ReLU follows the hidden layers alone: the features are linear, so that their cosine similarity has all of
    [-1, 1] to itself and no feature can die. The Siamese part is in the loss, which sends three states through
    the one network.

    Args:
        inputs: width of a state.
        features: width of the latent space (Table 4.1: 20).
        hidden: width of the hidden layers (the thesis gives none).

    Examples:
        >>> import torch
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
        return self.encoder(states)

    def forward(self, states: Tensor) -> tuple[Tensor, Tensor]:
        """States ``[*B, inputs]`` to features ``[*B, features]`` and reconstructions ``[*B, inputs]``."""
        features = self.encode(states)
        return features, self.decoder(features)
