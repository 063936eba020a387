"""Controller, eq. (31)-(33), its feature vectors, exploration, latency and drive lag."""
