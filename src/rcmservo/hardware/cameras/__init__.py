"""Camera drivers, and emulated cameras for tests without hardware.

To add a kind of camera, write its driver here and its settings class in settings.py, and list both
in hardware/device_kinds.py. Simulated cameras are in sim/cameras.py.
"""
