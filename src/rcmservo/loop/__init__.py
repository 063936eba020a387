"""The only code that makes anything move: the plant put together, a target taught, the loop run."""
