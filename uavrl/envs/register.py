"""Registration with Gymnasium, kept free of heavy imports: ``import uavrl`` runs it."""

from __future__ import annotations

from gymnasium.envs.registration import register, registry


def register_envs() -> None:
    """Registers ``uavrl/Valley-v0``: Gymnasium 1.0 loads no plugins, it imports what stands before the colon.

    Examples:
        >>> import gymnasium, uavrl
        >>> gymnasium.spec("uavrl/Valley-v0").entry_point
        'uavrl.envs.valley:ValleyEnv'
    """
    if "uavrl/Valley-v0" not in registry:
        register(id="uavrl/Valley-v0", entry_point="uavrl.envs.valley:ValleyEnv")
