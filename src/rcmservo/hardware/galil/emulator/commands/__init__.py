"""Commands of the emulated controller, grouped by subject."""
