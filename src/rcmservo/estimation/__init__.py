"""Estimators of the interaction matrix, eq. (17)-(30), and the fit of the camera's projection.

To add an estimator, write a class derived from `Estimator` (base.py) in a file here and list it in
config/class_registry.py. A user-defined estimator needs no list.
"""
