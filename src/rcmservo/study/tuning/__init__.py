"""Tuning by study: a search over settings of a method, validated on scenes outside the search."""
