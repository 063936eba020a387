"""The commands that bring up a laboratory."""
