"""Geometry of arm, tool and camera, eq. (1)-(16)."""
