"""The camera's pictures and the board beside them, for as many browsers as ask.

Each picture is encoded once. The one that the servo has used last is shown, so that what is drawn
on it is where it was seen; where no servo looks, the newest.
"""

import asyncio
import struct
from collections import OrderedDict
from dataclasses import dataclass, field

from rcmservo.config.texts import Table
from rcmservo.interfaces import Camera, Frame
from rcmservo.page.json_text import encode_json
from rcmservo.page.view_model import Dashboard
from rcmservo.tracking import encode_image

POLL_PERIOD_S = 0.006
"""s between looks at the camera."""
MIN_PICTURE_PERIOD_S = 0.025
"""s from picture to picture at least: 60 a second are for the servo, and half of them for the
eye."""
MAX_PICTURE_WAIT_S = 0.05
"""s after which what there is to tell is told without a new picture."""
MAX_WAITING_FRAMES = 12
"""Pictures that wait for the servo to use them."""
JSON_LENGTH = struct.Struct("<I")


@dataclass(frozen=True)
class ShownPicture:
    """A picture as browsers get it.

    Parameters
    ----------
    count : int
        It rises.
    number : int
        That of its frame.
    jpeg : bytes
        Empty where there is none.
    table : Table
        The board beside it.
    """

    count: int = 0
    number: int = -1
    jpeg: bytes = b""
    table: Table = field(default_factory=dict[str, object])


class Pictures:
    """What browsers see; `pump` keeps it new."""

    def __init__(self, camera: Camera, board: Dashboard) -> None:
        self._camera, self._board = camera, board
        self._frames: OrderedDict[int, Frame] = OrderedDict()
        self._newest, self._published = ShownPicture(), asyncio.Event()

    async def pump(self) -> None:
        """Keep the board new, and encode picture after picture."""
        loop, due = asyncio.get_running_loop(), 0.0
        while True:
            self._poll_camera()
            self._board.update()
            frame = self._next_frame() if loop.time() >= due else None
            if frame is not None and frame.image is not None:
                due, table = loop.time() + MIN_PICTURE_PERIOD_S, self._board.to_table()
                jpeg = await asyncio.to_thread(encode_image, frame.image)
                self._publish(frame.number, jpeg, table)
            await asyncio.sleep(POLL_PERIOD_S)

    def _poll_camera(self) -> None:
        frame = self._camera.latest()
        if frame is not None and frame.image is not None and frame.number not in self._frames:
            self._frames[frame.number] = frame
            while len(self._frames) > MAX_WAITING_FRAMES:
                self._frames.popitem(last=False)

    def _next_frame(self) -> Frame | None:
        """The frame that the servo has used last, or the newest where it has used none of late;
        None where that is shown already.
        """
        number, oldest = self._board.frame, next(iter(self._frames), -1)
        if number < oldest:
            number = next(reversed(self._frames))
        return None if number == self._newest.number else self._frames.get(number)

    def _publish(self, number: int, jpeg: bytes, table: Table) -> None:
        self._board.picture = jpeg
        self._newest = ShownPicture(self._newest.count + 1, number, jpeg, table)
        self._published.set()
        self._published = asyncio.Event()

    async def after(self, count: int) -> ShownPicture:
        """The picture shown once there is one after the `count`-th; what there is to tell without
        it where none comes.
        """
        if self._newest.count <= count:
            try:
                await asyncio.wait_for(self._published.wait(), MAX_PICTURE_WAIT_S)
            except TimeoutError:
                return ShownPicture(count, table=self._board.to_table())
        return self._newest


def pack_picture(shown: ShownPicture, about: Table) -> bytes:
    """A picture and the board as one message: the length of its JSON, that, and a JPEG."""
    table = {**shown.table, "frame": shown.number, **about}
    text = encode_json(table)
    return JSON_LENGTH.pack(len(text)) + text + shown.jpeg
