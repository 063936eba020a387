"""Bringing up a laboratory: what its arm and camera tell of the mistakes in its rig file."""
