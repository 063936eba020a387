"""Video of a simulated run with an overlay of the servo's state, and the frames of its record."""

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


def open_video(
    stack: ExitStack, folder: Path, settings: RigSettings, frames_per_image: int
) -> VideoWriter:
    """Open the video of a run with one image per `frames_per_image`; the stack closes it."""
    size_px = settings.width, settings.height
    images_per_s = settings.timing.frame_rate / frames_per_image
    video = VideoWriter(folder / "overlay.webm", size_px, images_per_s)
    stack.callback(video.close)
    return video


def make_frame_writer(
    plant: Plant, video: VideoWriter | None, recorder: Recorder | None
) -> Callable[[Tick], None]:
    """Return a function that writes each new frame to the overlay video and to the record."""
    last_frame: Frame | None = None
    frame_count = 0

    def write_frame(tick: Tick) -> None:
        nonlocal last_frame, frame_count
        frame = plant.frame
        if frame is None or frame.image is None or frame is last_frame:
            return
        last_frame = frame
        if video is not None and frame_count % FRAMES_PER_VIDEO_IMAGE == 0:
            video.write(draw_tick(frame.image, tick))
        frame_count += 1
        if recorder is not None:
            recorder.write_frame(frame)

    return write_frame


def draw_tick(image: Image, tick: Tick) -> Image:
    """Return a frame with the markers, the imaged RCM, the target and the state of the servo."""
    state = tick.state
    caption = f"{state.cause.value}\n{tick.time * 1e-9:5.2f} s  {state.phase.value}"
    if np.isfinite(state.delta).all():
        s_deg, r_px, d_px = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
        caption += f"  ds {s_deg:+.2f} deg  dr {r_px:+.2f} px  dd {d_px:+.2f} px"
    target = np.full((2, 2), np.nan) if state.target is None else state.target.points
    return draw_overlay(image, tick.observation.points, state.o_c, target, caption)
