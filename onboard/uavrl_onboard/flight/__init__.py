"""The flight: its loop, the safety layer, its log."""
