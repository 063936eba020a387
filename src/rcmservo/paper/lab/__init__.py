"""The simulated laboratory that experiments share: closed loops, methods, and judges."""
