"""What a study tells: statistics with their intervals, a summary, and one report."""
