"""Planners to compare a policy with."""
