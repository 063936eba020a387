"""Overlay video of a simulated run, and the frames of its record."""

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
"""Frames per image of the video: 15 images per second suffice, and each takes 30 ms to encode."""


def open_video(folder: Path, settings: RigSettings, stack: ExitStack) -> VideoWriter:
    """Open the overlay video, which the stack closes."""
    size, rate = (
        (settings.width, settings.height),
        settings.timing.frame_rate / FRAMES_PER_VIDEO_IMAGE,
    )
    video = VideoWriter(folder / "overlay.webm", size, rate)
    stack.callback(video.close)
    return video


def make_frame_writer(
    plant: Plant, video: VideoWriter | None, recorder: Recorder | None
) -> Callable[[Tick], None]:
    """Return a function that writes each new frame to the overlay video and to the record."""
    written: Frame | None = None
    count = 0

    def write_frame(tick: Tick) -> None:
        nonlocal written, count
        frame = plant.frame
        if frame is None or frame.image is None or frame is written:
            return
        written = frame
        if video is not None and count % FRAMES_PER_VIDEO_IMAGE == 0:
            video.write(draw_tick(frame.image, tick))
        count += 1
        if recorder is not None:
            recorder.write_frame(frame)

    return write_frame


def draw_tick(image: Image, tick: Tick) -> Image:
    """Return a frame with the markers, the imaged RCM, the target and the state of the servo."""
    state = tick.state
    words = f"{state.cause.value}\n{tick.time * 1e-9:5.2f} s  {state.phase.value}"
    if np.isfinite(state.delta).all():
        s, r, d = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
        words += f"  ds {s:+.2f} deg  dr {r:+.2f} px  dd {d:+.2f} px"
    target = np.full((2, 2), np.nan) if state.target is None else state.target.points
    return draw_overlay(image, tick.observation.points, state.o_c, target, words)
