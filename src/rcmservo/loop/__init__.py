"""Plant, teaching and loop: the only code that makes the arm move."""
