"""Pictures of the camera with the dashboard, for any number of browsers.

Each picture is encoded once. The page displays the picture that the servo has used last, so that
the overlay fits it; without a servo, the newest picture.
"""

import asyncio
import struct
from collections import OrderedDict
from dataclasses import dataclass, field

from rcmservo.config.toml_json_parsing import Table
from rcmservo.interfaces import Camera, Frame
from rcmservo.page.json_text import encode_json
from rcmservo.page.view_model import Dashboard
from rcmservo.tracking import encode_image

DRAWING_POLL_PERIOD_S = 0.006
"""Time (s) between polls of the camera."""
MIN_PICTURE_PERIOD_S = 0.025
"""Shortest time (s) between pictures: the servo needs 60 a second, a viewer half of them."""
MAX_PICTURE_WAIT_S = 0.05
"""Time (s) after which the dashboard is sent without a new picture."""
MAX_WAITING_FRAMES = 12
"""Number of frames that are stored until the servo has used them."""
JSON_LENGTH = struct.Struct("<I")


@dataclass(frozen=True)
class ShownPicture:
    """Displayed picture with its dashboard.

    Parameters
    ----------
    count : int
        Counter of displayed pictures.
    number : int
        Number of the frame.
    jpeg : bytes
        JPEG file; empty if there is no new picture.
    table : Table
        Content of the dashboard.
    """

    count: int = 0
    number: int = -1
    jpeg: bytes = b""
    table: Table = field(default_factory=dict[str, object])


class Pictures:
    """Encoder of pictures for browsers; `pump` must run."""

    def __init__(self, camera: Camera, board: Dashboard) -> None:
        self._camera, self._board = camera, board
        self._frames: OrderedDict[int, Frame] = OrderedDict()
        self._newest, self._published = ShownPicture(), asyncio.Event()

    async def pump(self) -> None:
        """Update the dashboard and encode pictures until the task is cancelled."""
        loop, due = asyncio.get_running_loop(), 0.0
        while True:
            self._poll_camera()
            self._board.update()
            frame = self._next_frame() if loop.time() >= due else None
            if frame is not None and frame.image is not None:
                due, table = loop.time() + MIN_PICTURE_PERIOD_S, self._board.to_table()
                jpeg = await asyncio.to_thread(encode_image, frame.image)
                self._publish(frame.number, jpeg, table)
            await asyncio.sleep(DRAWING_POLL_PERIOD_S)

    def _poll_camera(self) -> None:
        frame = self._camera.latest()
        if frame is not None and frame.image is not None and frame.number not in self._frames:
            self._frames[frame.number] = frame
            while len(self._frames) > MAX_WAITING_FRAMES:
                self._frames.popitem(last=False)

    def _next_frame(self) -> Frame | None:
        """Return the frame that the servo has used last, or the newest without a recent one.

        Returns
        -------
        Frame or None
            None if that frame is displayed already.
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
        """Return a picture after the `count`-th, or only the dashboard if none comes in time."""
        if self._newest.count <= count:
            try:
                await asyncio.wait_for(self._published.wait(), MAX_PICTURE_WAIT_S)
            except TimeoutError:
                return ShownPicture(count, table=self._board.to_table())
        return self._newest


def pack_picture(picture: ShownPicture, about: Table) -> bytes:
    """Encode a picture with its dashboard as a message: length of the JSON, the JSON, the JPEG."""
    table = {**picture.table, "frame": picture.number, **about}
    text = encode_json(table)
    return JSON_LENGTH.pack(len(text)) + text + picture.jpeg
