"""Selection of the transport: ROS 2 or ROS 1. The protocol of both is in ``messages``."""

from rcmservo.hardware.crtk.messages import Transport
from rcmservo.hardware.crtk.settings import RosConnection


def open_transport(connection: RosConnection) -> Transport:
    """Open a transport.

    Parameters
    ----------
    connection : RosConnection
        Version of ROS and its network.

    Raises
    ------
    NoTransport
        If a package is not installed, or the network cannot be used.
    """
    if connection.ros == 1:
        from rcmservo.hardware.crtk.ros1 import Ros1

        return Ros1()
    from rcmservo.hardware.crtk.ros2 import Ros2

    return Ros2(connection.domain, connection.interface)
