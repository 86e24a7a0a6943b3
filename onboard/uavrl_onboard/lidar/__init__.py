"""Scans of a real LiDAR: packets, recordings, and what they show."""
