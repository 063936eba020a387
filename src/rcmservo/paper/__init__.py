"""The reproduction of the paper: one module per experiment, and the table of its claims."""
