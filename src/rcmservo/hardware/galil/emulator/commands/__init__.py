"""What each command of the emulated controller does, by theme."""
