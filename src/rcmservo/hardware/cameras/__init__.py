"""Cameras of a laboratory: drivers, and emulated ones to try them on."""
