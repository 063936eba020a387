"""Choice of the transport: ROS 2 or ROS 1. Both import transport.py, which imports neither."""

from rcmservo.hardware.crtk.settings import RosConnection
from rcmservo.hardware.crtk.transport import Transport


def open_transport(where: RosConnection) -> Transport:
    """Return ROS 2 in a domain, on one network interface; or ROS 1, by the master that
    ROS_MASTER_URI names."""
    if where.ros == 1:
        from rcmservo.hardware.crtk.ros1 import Ros1

        return Ros1()
    from rcmservo.hardware.crtk.ros2 import Ros2

    return Ros2(where.domain, where.interface)
