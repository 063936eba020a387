"""Check of a rig file (`rig check`): small motions reveal mistakes in how it describes the arm."""
