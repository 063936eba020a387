"""Numerical basis of the kernels: small linear algebra."""
