"""Packaged policies, and scripted baselines."""
