"""Arm, camera, tracker and robot as one object, and the run that moves it."""
