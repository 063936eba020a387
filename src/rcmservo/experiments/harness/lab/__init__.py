"""The simulated laboratory of the experiments: loops, laws, methods, and who judges them."""
