"""What browsers are served: the page, its pictures and the websockets."""
