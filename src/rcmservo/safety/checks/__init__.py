"""Detectors of causes; each is a small pure function of the facts of a tick."""
