"""How far a camera's frame numbers have gone on.

GigE Vision counts from 1 to 65535 and then again from 1; newer devices count on for ever.
"""

LAST = 65535
"""After it comes 1, where ids are of 16 bits."""
MOST = 10_000
"""Frames that may be missing in a row; more is a camera that counts anew."""


class FrameIds:
    """The ids of one connection."""

    def __init__(self) -> None:
        self._last: int | None = None

    def step(self, number: int) -> int:
        """By how many frames the next id is further than the one before: 1 where none is
        missing, and where the camera counts anew."""
        last, self._last = self._last, number
        if last is None:
            return 1
        step = number - last
        if step < 0 and last <= LAST:
            step += LAST
        return step if 1 <= step <= MOST else 1
