"""uavrl's transforms and losses in the Hydra groups ``transform`` and ``loss`` of TorchRL's own trainers."""

from __future__ import annotations

import inspect
import re
from typing import Any

from hydra.core.config_store import ConfigStore

from uavrl import losses, transforms

GROUPS: dict[str, tuple[type, ...]] = {
    "transform": (
        transforms.TruncatedIcosahedron,
        transforms.RangeImage,
        transforms.NavigationObservation,
        transforms.NavigationState,
        transforms.NavigationReward,
        transforms.TraditionalReward,
    ),
    "loss": (
        losses.TD3Loss,
        losses.DDPGLoss,
        losses.SACLoss,
        losses.Fork,
        losses.LifeGuard,
        losses.Imitation,
        losses.PSAELoss,
    ),
}


def register_in_torchrl() -> None:
    """Stores them as ``uavrl_<class name in snake case>``, with the constructors' defaults; call it before Hydra.

    What has no default, such as networks, is given to ``hydra.utils.instantiate``, or written below the node.

    Examples:
        >>> from hydra.utils import instantiate
        >>> register_in_torchrl()
        >>> node = ConfigStore.instance().load("transform/uavrl_truncated_icosahedron.yaml").node
        >>> instantiate(node, radius=2.0).radius
        2.0
    """
    store = ConfigStore.instance()
    for group, members in GROUPS.items():
        for member in members:
            words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", member.__name__).lower()
            target = f"{member.__module__}.{member.__qualname__}"
            store.store(group=group, name=f"uavrl_{words}", node={"_target_": target, **_defaults(member)})


def _defaults(member: type) -> dict[str, Any]:
    parameters = inspect.signature(member.__init__).parameters.values()  # type: ignore[misc]
    given = {one.name: one.default for one in parameters if one.default is not inspect.Parameter.empty}
    plain = (bool, int, float, str, tuple, list, type(None))
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in given.items()
        if isinstance(value, plain)
    }
