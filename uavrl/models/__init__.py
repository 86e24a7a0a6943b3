"""Networks as plain ``torch.nn`` modules."""

from uavrl.models.actor_critic import Actor, Critic, mlp

__all__ = ["Actor", "Critic", "mlp"]
