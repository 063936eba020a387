"""Recordings by other software: reading them, and scoring the estimators on them."""
