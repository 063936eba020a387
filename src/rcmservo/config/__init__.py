"""What can be named and written down: rigs, servos and targets in files."""
