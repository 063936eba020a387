"""Control law, eq. (31)-(33), its feature vectors, exploration, and drive lag."""
