"""An emulator of the controller, for developing without one. It is a simulation, and says so."""
