"""Simulated arm and camera as separate processes, in wall time."""
