"""Runs of the past, for the page: which there are, and one of them opened."""
