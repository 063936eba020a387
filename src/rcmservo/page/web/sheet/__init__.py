"""The page as it is laid out. What moves on it is drawn in the browser, by ../static."""
