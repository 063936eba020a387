"""Cameras that are not there: they send frames of somebody else's as a device would."""
