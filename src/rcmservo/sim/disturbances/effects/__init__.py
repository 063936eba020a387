"""Effects of the disturbances, in files by origin: camera, delivery of frames, arm and computer.

Each file simulates the kinds whose rows in disturbance_kinds.py name it.
"""
