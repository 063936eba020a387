"""What the page draws beside the picture: curves over time, the tool in space."""
