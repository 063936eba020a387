"""Choice of the transport: ROS 2 or ROS 1. Both import transport.py, which imports neither."""

from rcmservo.hardware.crtk.transport import Transport


def open_transport(ros: int, domain: int, interface: str) -> Transport:
    """Return ROS 2 in a domain, on one network interface; or ROS 1, by the master that
    ROS_MASTER_URI names."""
    if ros == 1:
        from rcmservo.hardware.crtk.ros1 import Ros1

        return Ros1()
    from rcmservo.hardware.crtk.ros2 import Ros2

    return Ros2(domain, interface)
