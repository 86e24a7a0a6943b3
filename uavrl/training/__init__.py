"""Builds and runs trainings and evaluations from configurations."""
