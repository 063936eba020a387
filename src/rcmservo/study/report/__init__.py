"""Report of a study: statistics with confidence intervals, a summary and an HTML page."""
