"""The simulated arm and camera as processes of their own, in wall time."""
