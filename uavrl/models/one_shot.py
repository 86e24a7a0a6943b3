"""One-shot classification of states by convolutional features (Chansuparp (2022), §3.3; the classifier of ABR)."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def convolve_frames(states: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Convolves states along time, and makes their ReLU features' length 1; where all are 0 they become equal.

    States are frames end to end, oldest first, ``[N, frames * width]``. With a weight ``[channels, width, kernel]`` and
    a bias ``[channels]`` they give ``[N, channels * (frames - kernel + 1)]``.
    """
    width, kernel = weight.shape[1:]
    if states.ndim != 2 or states.shape[1] % width or states.shape[1] < width * kernel:
        raise ValueError(f"Expected states [N, frames * {width}] of {kernel} frames or more, got {list(states.shape)}.")
    if not bool(states.isfinite().all()):
        raise ValueError("Expected finite states, got some that are not: check the observations.")
    frames = states.unflatten(-1, (-1, width)).transpose(-1, -2)
    features = F.relu(F.conv1d(frames.to(weight), weight, bias)).flatten(1)
    length = features.norm(dim=-1, keepdim=True)
    return torch.where(length > 0, features / length, features.shape[-1] ** -0.5)


def join_or_found(features: Tensor, exemplars: Tensor, threshold: float, max_classes: int) -> tuple[Tensor, Tensor]:
    """Each row in turn joins the class of the most similar exemplar, or founds a class as its exemplar.

    It joins from a cosine similarity of ``threshold`` on, and always once there are ``max_classes``. Features
    ``[N, F]`` and exemplars ``[C, F]`` of length 1 give labels ``[N]`` and exemplars ``[C', F]``, the new ones last.
    """
    best = features.new_full((len(features),), -torch.inf)
    labels = torch.zeros(len(features), dtype=torch.int64, device=features.device)
    if len(exemplars):
        best, labels = (features @ exemplars.T).max(-1)
    founders: list[int] = []
    row = 0
    while len(exemplars) + len(founders) < max_classes:
        alone = (best[row:] < threshold).nonzero()
        if not len(alone):
            break
        row += int(alone[0])
        similarity = features[row:] @ features[row]
        similarity[0] = torch.inf  # a founder is in its own class, whatever the rounding
        closer = similarity > best[row:]
        best[row:] = torch.where(closer, similarity, best[row:])
        labels[row:] = torch.where(closer, len(exemplars) + len(founders), labels[row:])
        founders.append(row)
        row += 1
    return labels, torch.cat([exemplars, features[founders]])


class OneShotClassifier(nn.Module):
    """Classes of states that look alike to a small convolution nobody trains.

    A state joins the class whose exemplar is the most similar if their cosine similarity reaches ``threshold``;
    else it founds a class and is its exemplar. The thesis leaves the network open: here one convolution of kernel 2
    along time with ReLU, drawn from a seed, gives 10 channels at 2 places = 20 features for 3 frames. The exemplars
    are part of the state dict.

    Args:
        width: numbers in a frame.
        frames: frames in a state.
        features: number of features, a multiple of ``frames - kernel + 1``.
        kernel: frames that the convolution sees at once.
        threshold: cosine similarity (Table 4.1: 98 %).
        max_classes: bounds the memory; once reached, a state joins the most similar class whatever the threshold.
        seed: draws the convolution.

    Raises:
        ValueError: for settings that do not fit; at a call, for states that do not fit or are not finite.

    Examples:
        >>> OneShotClassifier(width=4)(torch.ones(2, 12)).tolist()
        [0, 0]
    """

    weight: Tensor
    bias: Tensor
    exemplars: Tensor

    CHUNK = 1024  # states compared with all exemplars at once

    def __init__(
        self,
        width: int = 35,
        frames: int = 3,
        features: int = 20,
        *,
        kernel: int = 2,
        threshold: float = 0.98,
        max_classes: int = 20_000,
        seed: int = 0,
    ) -> None:
        super().__init__()
        places = frames - kernel + 1
        if min(width, kernel, features, max_classes) < 1 or places < 1 or features % places:
            raise ValueError(
                f"Expected positive sizes, a kernel of at most {frames} frames, and features that divide by the "
                f"kernel's {places} places, got width={width}, kernel={kernel}, features={features}, "
                f"max_classes={max_classes}."
            )
        if not -1.0 <= threshold <= 1.0:
            raise ValueError(f"Expected a cosine similarity in [-1, 1] as threshold, got {threshold}.")
        self.frames, self.threshold, self.max_classes = frames, threshold, max_classes
        generator = torch.Generator().manual_seed(seed)
        bound = (width * kernel) ** -0.5
        for name, shape in {"weight": (features // places, width, kernel), "bias": (features // places,)}.items():
            self.register_buffer(name, bound * (2 * torch.rand(shape, generator=generator, dtype=torch.float32) - 1))
        self.register_buffer("exemplars", torch.empty(0, features, dtype=torch.float32))

    def __len__(self) -> int:
        """How many classes there are."""
        return len(self.exemplars)

    @torch.no_grad()
    def forward(self, states: Tensor) -> Tensor:
        """States ``[N, frames * width]``, in order, to int64 labels ``[N]``; new classes may be founded."""
        if states.ndim != 2 or states.shape[1] != self.frames * self.weight.shape[1]:
            expected = f"[N, {self.frames} * {self.weight.shape[1]}]"
            raise ValueError(f"Expected states {expected}, got {list(states.shape)}: set width and frames to fit.")
        features = convolve_frames(states.to(self.weight.device), self.weight, self.bias)
        labels = []
        for chunk in features.split(self.CHUNK):
            found, self.exemplars = join_or_found(chunk, self.exemplars, self.threshold, self.max_classes)
            labels.append(found)
        return torch.cat(labels)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        """Makes room for as many exemplars as the state holds."""
        found = state_dict.get(f"{prefix}exemplars")
        if found is not None and found.shape[1:] == self.exemplars.shape[1:]:
            self.exemplars = self.exemplars.new_empty(found.shape)
        super()._load_from_state_dict(state_dict, prefix, *args)
