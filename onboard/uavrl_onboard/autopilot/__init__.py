"""The autopilot: its state, its frames, and set-points to it by MAVLink."""
