"""Video of a simulated run, in which each image also shows the servo's state.

The function that writes the video can also write every frame to the record of the run.
"""

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
"""Number of camera frames per image of the video.

At 60 frames/s the video has 15 images per second, which suffice; encoding an image takes 30 ms.
"""


def open_video(
    exit_stack: ExitStack, folder: Path, settings: RigSettings, frames_per_image: int
) -> VideoWriter:
    """Open `overlay.webm`, the video of a run; `exit_stack` closes it.

    Parameters
    ----------
    exit_stack : ExitStack
        Stack of the run.
    folder : Path
        Folder of the run.
    settings : RigSettings
        Settings of the simulated lab: image size and frame rate.
    frames_per_image : int
        Number of camera frames per image of the video: it plays in real time if every such frame is
        written.

    Returns
    -------
    VideoWriter
        Open video.
    """
    size_px = settings.width, settings.height
    images_per_s = settings.timing.frame_rate / frames_per_image
    video = VideoWriter(folder / "overlay.webm", size_px, images_per_s)
    exit_stack.callback(video.close)
    return video


def make_frame_writer(
    plant: Plant, video: VideoWriter | None, recorder: Recorder | None, frames_per_image: int
) -> Callable[[Tick], None]:
    """Return a function of a tick that writes the plant's frame if it is new and has an image.

    Parameters
    ----------
    plant : Plant
        Plant of the run.
    video : VideoWriter or None
        Video that receives every `frames_per_image`-th frame; None for no video.
    recorder : Recorder or None
        Record that receives every frame; None if the record has no frames.
    frames_per_image : int
        Number of camera frames per image of the video, as in `open_video`.

    Returns
    -------
    callable
        Function to call at each tick.
    """
    previous_frame: Frame | None = None
    frame_count = 0

    def handle_tick(tick: Tick) -> None:
        nonlocal previous_frame, frame_count
        frame = plant.frame
        if frame is None or frame.image is None or frame is previous_frame:
            return
        previous_frame = frame
        if video is not None and frame_count % frames_per_image == 0:
            video.write(draw_servo_state(frame.image, tick))
        frame_count += 1
        if recorder is not None:
            recorder.write_frame(frame)

    return handle_tick


def draw_servo_state(image: Image, tick: Tick) -> Image:
    """Return a copy of an image with markers, imaged RCM, target, and a caption.

    The caption states cause, time and phase, and the feature errors where they are known.
    """
    state = tick.state
    caption = f"{state.cause.value}\n{tick.time * 1e-9:5.2f} s  {state.phase.value}"
    if np.isfinite(state.delta).all():
        s_error_deg, r_error_px, d_error_px = np.degrees(state.delta[0]), *state.delta[1:]
        caption += f"  ds {s_error_deg:+.2f} deg  dr {r_error_px:+.2f} px  dd {d_error_px:+.2f} px"
    target_points = np.full((2, 2), np.nan) if state.target is None else state.target.points
    return draw_overlay(image, tick.observation.points, state.o_c, target_points, caption)
