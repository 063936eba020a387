"""Causes of stops, their checks, the state machine, the safety gate and the watchdog."""
