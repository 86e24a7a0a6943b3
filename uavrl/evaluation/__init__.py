"""Policies in the air without exploration noise: evaluation, recording, yardsticks and the suite of scenarios."""
