"""Protocols of real devices and of the operator next to them, beyond what the loop needs.

A real arm is connected with its drive off. It reports whether its joint values are known, and why
its drive went off by itself. A real camera counts its frames.
"""

from contextlib import AbstractContextManager, ExitStack
from typing import Any, Protocol, runtime_checkable

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Arm, Camera, Floats, Tracker
from rcmservo.loop.run_result import CameraStatistics


class NotReady(RcmServoError):
    """Error of a device that cannot be used in its present state."""


class LabArm(Arm, Protocol):
    """Real arm that is connected."""

    @property
    def off_reason(self) -> str:
        """Reason for which the drive went off by itself, in a sentence; empty if it did not."""
        ...

    def is_homed(self) -> bool:
        """Return True if the joint values are known since the arm was reset.

        Raises
        ------
        NotReady
            If they are unknown and the operator cannot define them.
        """
        ...

    def set_position(self, q: Floats) -> None:
        """Set the present joint values (3,) in rad, rad, mm, at rest and with the drive off.

        Raises
        ------
        NotReady
            If the arm is homed by its own software.
        """
        ...

    def close(self) -> None:
        """Stop the arm, disable its drive and disconnect."""
        ...


@runtime_checkable
class SuspendsCommunication(Protocol):
    """Arm to which communication can be suspended, so that its watchdog can be tested."""

    @property
    def is_rate_controlled(self) -> bool:
        """True if the arm receives joint rates, so that only its watchdog stops it without them."""
        ...

    def suspend_communication(self) -> None:
        """Send nothing more, as if this program were dead, until the drive is next switched."""
        ...


class LabCamera(Camera, Protocol):
    """Real camera that is open."""

    def counts(self) -> CameraStatistics:
        """Return the counts of frames so far."""
        ...

    def close(self) -> None:
        """Release the camera."""
        ...


class DeviceBundle(Protocol):
    """Arm, camera and tracker that are connected while a context runs, such as those of a rig."""

    arm: Arm
    camera: Camera
    tracker: Tracker

    def connected(self) -> AbstractContextManager[None]:
        """Connect the devices, with the drive off, and close them at the end."""
        ...


def close_at_end(device: object, stack: ExitStack) -> None:
    """Close a device at the end of a context if it has a method ``close``."""
    close: Any = getattr(device, "close", None)
    if close is not None:
        stack.callback(close)


class OperatorTerminal(Protocol):
    """Operator at the arm, who answers questions."""

    def notify(self, message: str) -> None:
        """Report something that needs no answer."""
        ...

    def ask(self, question: str) -> str:
        """Return the operator's answer without surrounding spaces.

        Lines that were typed before the question are discarded.

        Raises
        ------
        Stopped
            If the operator ends the program (Ctrl-C, Ctrl-D) or another process does.
        """
        ...
