"""Reproduction of the paper: one module per experiment, the table of claims, and the report."""
