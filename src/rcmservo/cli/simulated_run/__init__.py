"""One simulated run from its settings to a folder of results."""
