"""Web servers of the page: routes, websockets, pictures and access."""
