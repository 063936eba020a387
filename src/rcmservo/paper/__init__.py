"""Reproduction of the paper: experiments that check its claims, the table of claims, the report.

A file NAME_claims.py is one experiment: it measures claims, and implements no part of the method.
The equations are implemented in geometry (1)-(16), estimation (17)-(30) and control (31)-(33).
"""
