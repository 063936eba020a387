"""Arms that speak CRTK, the collaborative robotics toolkit, over ROS 2 or ROS 1."""
