"""The pictures of a simulated run: the overlay video as it goes."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from rcmservo.figures.overlay import draw_overlay
from rcmservo.figures.video import VideoWriter
from rcmservo.interfaces import Frame, Image
from rcmservo.loop.plant import Plant
from rcmservo.loop.tick import Tick
from rcmservo.recording.writer import Recorder
from rcmservo.sim import RigSettings

FRAMES_PER_VIDEO_IMAGE = 4
"""Frames from one picture of the video to the next: 15 pictures a second are enough to look at, and
each takes 30 ms to encode."""


def open_video(folder: Path, settings: RigSettings, stack: ExitStack) -> VideoWriter:
    """The overlay video."""
    size, rate = (
        (settings.width, settings.height),
        settings.timing.frame_rate / FRAMES_PER_VIDEO_IMAGE,
    )
    video = VideoWriter(folder / "overlay.webm", size, rate)
    stack.callback(video.close)
    return video


def frame_writer(
    plant: Plant, video: VideoWriter | None, recorder: Recorder | None
) -> Callable[[Tick], None]:
    """What to do with every new frame: add it to the overlay video, and to the record."""
    shown: Frame | None = None
    count = 0

    def picture(tick: Tick) -> None:
        nonlocal shown, count
        frame = plant.frame
        if frame is None or frame.image is None or frame is shown:
            return
        shown = frame
        if video is not None and count % FRAMES_PER_VIDEO_IMAGE == 0:
            video.write(overlay(frame.image, tick))
        count += 1
        if recorder is not None:
            recorder.write_frame(frame)

    return picture


def overlay(image: Image, tick: Tick) -> Image:
    """A frame with what the servo makes of it."""
    state = tick.state
    words = f"{state.cause.value}\n{tick.time * 1e-9:5.2f} s  {state.phase.value}"
    if np.isfinite(state.delta).all():
        s, r, d = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
        words += f"  ds {s:+.2f} deg  dr {r:+.2f} px  dd {d:+.2f} px"
    target = np.full((2, 2), np.nan) if state.target is None else state.target.points
    return draw_overlay(image, tick.seen.points, state.o_c, target, words)
