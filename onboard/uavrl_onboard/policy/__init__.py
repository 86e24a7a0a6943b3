"""An exported policy: its contract, its network, and what it reads."""
