"""Scenes drawn from a seed: what is drawn, which ways they hold, and whether one suits."""
