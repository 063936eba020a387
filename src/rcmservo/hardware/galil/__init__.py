"""Driver and emulator of Galil DMC-40x0 motion controllers."""
