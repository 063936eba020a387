"""Registry of names, and files that describe rigs, servos and targets."""
