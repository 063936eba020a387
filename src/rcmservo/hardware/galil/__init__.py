"""Galil DMC-40x0 motion controllers."""
