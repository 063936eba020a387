"""Numerical basis: compilation, structs with named fields, small linear algebra, least squares."""
