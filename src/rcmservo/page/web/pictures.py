"""The camera's pictures and the board beside them, for as many browsers as ask.

Each picture is encoded once. The one that the servo has used last is shown, so that what is drawn
on it is where it was seen; where no servo looks, the newest.
"""

import asyncio
import json
import struct
from collections import OrderedDict
from dataclasses import dataclass, field

from rcmservo.interfaces import Camera, Frame
from rcmservo.page.board import Board, Table
from rcmservo.tracking import encode_image

LOOK = 0.004
"""s between looks at the camera."""
WITHOUT = 0.05
"""s after which what there is to tell is told without a new picture."""
KEPT = 12
"""Pictures that wait for the servo to use them."""
LENGTH = struct.Struct("<I")


@dataclass(frozen=True)
class ShownPicture:
    """A picture as browsers get it."""

    count: int = 0
    """It rises."""
    number: int = -1
    """That of its frame."""
    jpeg: bytes = b""
    """Empty where there is none."""
    table: Table = field(default_factory=dict[str, object])
    """The board beside it."""


class Pictures:
    """What browsers see; `pump` keeps it new."""

    def __init__(self, camera: Camera, board: Board) -> None:
        self._camera, self._board = camera, board
        self._frame: Frame | None = None
        self._encoded: OrderedDict[int, bytes] = OrderedDict()
        self._shown, self._new = ShownPicture(), asyncio.Event()

    async def pump(self) -> None:
        """Encode picture after picture, and keep the board new."""
        while True:
            frame = self._camera.latest()
            if frame is not None and frame is not self._frame and frame.image is not None:
                self._frame = frame
                self._encoded[frame.number] = await asyncio.to_thread(encode_image, frame.image)
                while len(self._encoded) > KEPT:
                    self._encoded.popitem(last=False)
            self._board.look()
            self._choose()
            await asyncio.sleep(LOOK)

    def _choose(self) -> None:
        """Show the picture that the servo has used last, or the newest."""
        newest = next(reversed(self._encoded), -1)
        number = self._board.frame if self._board.frame in self._encoded else newest
        if number == self._shown.number or number < 0:
            return
        jpeg = self._board.picture = self._encoded[number]
        table = self._board.table()
        self._shown = ShownPicture(self._shown.count + 1, number, jpeg, table)
        self._new.set()
        self._new = asyncio.Event()

    async def after(self, count: int) -> ShownPicture:
        """The picture shown once there is one after the `count`-th; what there is to tell without
        it where none comes."""
        if self._shown.count <= count:
            try:
                await asyncio.wait_for(self._new.wait(), WITHOUT)
            except TimeoutError:
                return ShownPicture(count, table=self._board.table())
        return self._shown


def packed(shown: ShownPicture, about: Table) -> bytes:
    """A picture and the board as one message: the length of its JSON, that, and a JPEG."""
    table = {**shown.table, "frame": shown.number, **about}
    text = json.dumps(table, separators=(",", ":")).encode()
    return LENGTH.pack(len(text)) + text + shown.jpeg
