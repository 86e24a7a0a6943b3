"""From recorded states to the artifact that ABR⁺ loads."""

from uavrl.pretraining.recording import Recording, StateRecorder, read_recording
from uavrl.pretraining.triples import triple_centres

__all__ = ["Recording", "StateRecorder", "read_recording", "triple_centres"]
