"""Registration with Gymnasium, kept free of heavy imports: ``import uavrl`` runs it."""


def register_envs() -> None:
    """Registers ``uavrl/Valley-v0`` where Gymnasium is installed.

    Gymnasium 1.0 loads no plugins: it imports what stands before the colon of ``uavrl:uavrl/Valley-v0``.
    """
    try:
        from gymnasium.envs.registration import register, registry
    except ImportError:  # the losses, models and transforms do not need it
        return
    if "uavrl/Valley-v0" not in registry:
        register(
            id="uavrl/Valley-v0",
            entry_point="uavrl.envs.gym:make_valley",
            vector_entry_point="uavrl.envs.gym_vector:make_valleys",
        )
