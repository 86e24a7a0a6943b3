"""What a policy reads of a scan: cells, observation, moving objects."""
