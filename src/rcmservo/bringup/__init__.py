"""Check of a laboratory that finds the mistakes in its rig file with the arm and the camera."""
