"""The transforms inside of a composition."""

from torchrl.envs import Compose, Transform


def inner_transforms(transform: Transform | None) -> list[Transform]:
    """The transforms of a composition, in their order."""
    if isinstance(transform, Compose):
        return [inner for outer in transform.transforms for inner in inner_transforms(outer)]
    return [] if transform is None else [transform]
