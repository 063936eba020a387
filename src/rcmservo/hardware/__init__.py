"""Real devices: a driver in a folder of its own for each kind, and emulators of some of them."""
