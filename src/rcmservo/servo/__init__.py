"""Composition of features, estimation, controller and safety into one pure step."""
