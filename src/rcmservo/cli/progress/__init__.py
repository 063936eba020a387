"""Progress of commands."""
