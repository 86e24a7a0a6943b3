"""Registration with Gymnasium, kept free of heavy imports: Gymnasium runs it at its own import."""

from __future__ import annotations


def register_envs() -> None:
    """Registers ``uavrl/Valley-v0``; Gymnasium calls this through an entry point, in the namespace ``uavrl``."""
    from gymnasium.envs.registration import register

    register(id="Valley-v0", entry_point="uavrl.envs.valley:ValleyEnv")
