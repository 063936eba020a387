"""A run in wall time and in several processes."""
