"""Data of the page's plots: curves over time and the tool in space."""
