"""Simulated laboratory that the experiments share: closed loops, methods and evaluation."""
