"""How messages get from one program to another: one small Protocol, for ROS 2 and ROS 1."""

from collections.abc import Callable
from typing import Any, Protocol

from rcmservo.errors import RcmServoError
from rcmservo.hardware.crtk.messages import Said, Topic

Heard = Callable[[Said, str], None]
"""Is told a message and a name for its writer, in a thread of the transport; it must return soon,
and raise nothing."""


class NoTransport(RcmServoError):
    """ROS that cannot be spoken here."""


class Transport(Protocol):
    """A way for messages. What a transport sends itself, it does not hear."""

    def publish(self, topic: Topic[Said], message: Said) -> bool:
        """Send a message at once; whether it went out. The first one of a topic makes it known."""
        ...

    def subscribe(self, topic: Topic[Said], heard: Heard[Said]) -> None:
        """Have every message told. What is no such message is dropped."""
        ...

    def offer(self, topic: Topic[Any]) -> None:
        """Make known that messages will be sent: who wants them needs a moment to be found."""
        ...

    def listeners(self, topic: Topic[Any]) -> int:
        """How many hear what is sent on a topic."""
        ...

    def close(self) -> None:
        """No more of it."""
        ...
