"""Emulated cameras that send the frames of another camera over a real camera protocol."""
