"""Driver and emulator of CRTK arms (collaborative robotics toolkit) over ROS 2 or ROS 1."""
