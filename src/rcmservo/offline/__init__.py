"""Recorded frames of others: how such a folder is read, and how the method is scored on it."""
