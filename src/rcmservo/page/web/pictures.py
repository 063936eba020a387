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
from rcmservo.page.view_model import Dashboard, encode_json
from rcmservo.tracking import encode_image

CAMERA_POLL_PERIOD_S = 0.006
"""Time (s) between polls of the camera."""
MIN_PICTURE_PERIOD_S = 0.025
"""Shortest time (s) between pictures: the servo needs 60 a second, a viewer half of them."""
MAX_PICTURE_WAIT_S = 0.05
"""Time (s) after which the dashboard is sent without a new picture."""
MAX_WAITING_FRAMES = 12
"""Number of frames that are stored until the servo has used them."""
JSON_LENGTH = struct.Struct("<I")
"""Length in bytes of the JSON in a message."""


@dataclass(frozen=True)
class DisplayedPicture:
    """Picture with the dashboard that the browsers display next to it.

    Parameters
    ----------
    count : int
        Number of pictures up to this one.
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
        self._newest, self._published = DisplayedPicture(), asyncio.Event()

    async def pump(self) -> None:
        """Update the dashboard and encode pictures until the task is cancelled."""
        loop, next_picture_s = asyncio.get_running_loop(), 0.0
        while True:
            self._poll_camera()
            self._board.update()
            frame = self._find_next_frame() if loop.time() >= next_picture_s else None
            if frame is not None and frame.image is not None:
                next_picture_s = loop.time() + MIN_PICTURE_PERIOD_S
                table = self._board.to_table()
                jpeg = await asyncio.to_thread(encode_image, frame.image)
                self._publish(frame.number, jpeg, table)
            await asyncio.sleep(CAMERA_POLL_PERIOD_S)

    def _poll_camera(self) -> None:
        frame = self._camera.latest()
        if frame is not None and frame.image is not None and frame.number not in self._frames:
            self._frames[frame.number] = frame
            while len(self._frames) > MAX_WAITING_FRAMES:
                self._frames.popitem(last=False)

    def _find_next_frame(self) -> Frame | None:
        """Return the frame to display, or None if it is displayed already.

        It is the last frame that the servo has used, or the newest one if the servo uses none.
        """
        number, oldest = self._board.frame, next(iter(self._frames), -1)
        if number < oldest:
            number = next(reversed(self._frames))
        return None if number == self._newest.number else self._frames.get(number)

    def _publish(self, number: int, jpeg: bytes, table: Table) -> None:
        self._board.picture = jpeg
        self._newest = DisplayedPicture(self._newest.count + 1, number, jpeg, table)
        self._published.set()
        self._published = asyncio.Event()

    async def after(self, count: int) -> DisplayedPicture:
        """Return the newest picture if it comes after the first `count` ones.

        Wait for it `MAX_PICTURE_WAIT_S` at most, then return the dashboard without a picture.
        """
        if self._newest.count <= count:
            try:
                await asyncio.wait_for(self._published.wait(), MAX_PICTURE_WAIT_S)
            except TimeoutError:
                return DisplayedPicture(count, table=self._board.to_table())
        return self._newest


def pack_picture(picture: DisplayedPicture, owners: Table) -> bytes:
    """Encode a picture as a message: length of the JSON, the JSON, the JPEG.

    The JSON holds the dashboard, the number of the frame and the `owners` of control.
    """
    json = encode_json({**picture.table, "frame": picture.number, **owners})
    return JSON_LENGTH.pack(len(json)) + json + picture.jpeg
