"""Drivers of arms and cameras, in one folder per kind, and emulators of some of them."""
