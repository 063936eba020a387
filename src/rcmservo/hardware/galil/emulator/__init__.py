"""Emulator of a Galil controller, for development without a real one."""
