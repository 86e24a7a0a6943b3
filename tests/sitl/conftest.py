"""Environments in a small valley, closed after each test."""

from tests.envs.conftest import make

__all__ = ["make"]
