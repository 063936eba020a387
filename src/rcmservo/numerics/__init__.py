"""Numerical basis of the kernels: compilation, structs with named fields, small linear algebra."""
