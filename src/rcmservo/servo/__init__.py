"""Composition of features, estimation, control law and safety into one pure step."""
