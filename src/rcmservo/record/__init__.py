"""A run on disk: how it is laid out, written, read, computed again and judged."""
