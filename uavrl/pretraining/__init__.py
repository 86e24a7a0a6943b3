"""From the states of a run to the artifact that ABR⁺ loads."""

from uavrl.pretraining.states import States, read_states, triple_centres

__all__ = ["States", "read_states", "triple_centres"]
