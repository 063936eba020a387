"""Charts, annotated images and videos of a run."""
