"""Past runs on the page: the list, and one run opened."""
