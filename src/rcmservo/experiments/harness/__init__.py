"""What the experiments share: closed loops, statistics, the work on all cores, and the report."""
