"""A run in wall time and in several processes. It is handed its devices, and does not know where
they come from."""
