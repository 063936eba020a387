"""Runs in wall time in several processes, on devices that the caller supplies."""
