"""Sampling of scenes: joints, cameras and paths, and the test of their feasibility."""
