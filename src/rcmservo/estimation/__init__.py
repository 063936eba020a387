"""Estimators of the interaction matrix, eq. (17)-(30), and the fit of the camera's projection."""
