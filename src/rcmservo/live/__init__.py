"""Runs in wall time, in several processes. The caller supplies the devices."""
