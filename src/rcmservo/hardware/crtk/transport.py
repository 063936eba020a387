"""Selection of the transport: ROS 2 or ROS 1. The protocol of both is in ``messages``."""

from rcmservo.hardware.crtk.messages import Transport


def open_transport(ros: int, domain: int, interface: str) -> Transport:
    """Open a transport.

    Parameters
    ----------
    ros : int
        2 or 1. ROS 1 uses the master in ROS_MASTER_URI.
    domain : int
        Domain of ROS 2.
    interface : str
        Network interface of ROS 2.

    Raises
    ------
    NoTransport
        If a package is not installed, or the network cannot be used.
    """
    if ros == 1:
        from rcmservo.hardware.crtk.ros1 import Ros1

        return Ros1()
    from rcmservo.hardware.crtk.ros2 import Ros2

    return Ros2(domain, interface)
