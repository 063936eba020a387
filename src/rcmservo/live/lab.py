"""What a laboratory's devices offer beside what the loop needs of them, and the person beside them.

An arm of the laboratory is connected with its drive off. It knows whether anybody has said where
it stands, and why its drive went off by itself. A camera keeps account of its frames.
"""

from typing import Protocol, runtime_checkable

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Arm, Camera, Floats
from rcmservo.loop.run_result import CameraAccount


class NotReady(RcmServoError):
    """A device that cannot be used as it stands."""


class LabArm(Arm, Protocol):
    """An arm that is connected."""

    @property
    def why_off(self) -> str:
        """Why the drive went off by itself, in a sentence; empty where it did not."""
        ...

    def homed(self) -> bool:
        """Whether the arm knows where it stands since it was reset. :class:`NotReady` of one that
        does not, where a person cannot say it."""
        ...

    def define(self, q: Floats) -> None:
        """A person says that the joints (3,) stand at q, at rest and with the drive off.
        :class:`NotReady` of an arm that is homed by its own software."""
        ...

    def close(self) -> None:
        """Bring it to rest, switch it off, and hang up."""
        ...


@runtime_checkable
class FallsSilent(Protocol):
    """An arm that can be left alone, so that it is seen what it does then."""

    @property
    def by_speeds(self) -> bool:
        """Whether it is sent speeds, and goes on for ever unless it stops by itself."""
        ...

    def fall_silent(self) -> None:
        """Say nothing to it any more, as if this program were dead, until it is to be switched off
        or on."""
        ...


class LabCamera(Camera, Protocol):
    """A camera that is open."""

    def account(self) -> CameraAccount:
        """What became of its frames so far."""
        ...

    def close(self) -> None:
        """Let it go."""
        ...


class Person(Protocol):
    """Somebody at the arm, who answers what is asked."""

    def tell(self, words: str) -> None:
        """Say something that needs no answer."""
        ...

    def ask(self, question: str) -> str:
        """What the person answers, without spaces about it. Lines that were typed before the
        question was asked are no answer. It raises :class:`Stopped` where the person ends it
        (Ctrl-C, Ctrl-D), and whoever else ends the program."""
        ...
