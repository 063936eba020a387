"""Causes of a stop, their checks, the state machine, the gate and the watchdog."""
