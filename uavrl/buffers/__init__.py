"""Replay-buffer transforms."""
