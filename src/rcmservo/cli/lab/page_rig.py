"""Arm and camera of a lab for the operator's page.

rig file ─► camera, for the size of its images ─► sessions
                                                  arm: stopped by STOP; camera: shown on the page

The page's operator is the one at the arm, who defines the joint values and enables the drive.
"""

from collections.abc import Generator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from rcmservo.cli.lab.hardware_prompts import (
    define_joints,
    describe_target_setup,
    get_lab_arm,
    require_drive_off,
)
from rcmservo.cli.lab.live_on_hardware import (
    describe_hardware_run,
    describe_speed_limits,
    find_allowed_speed_scale,
)
from rcmservo.cli.lab.page_backend import (
    RECORDED_IMAGES_PER_S,
    SESSION_DURATION_S,
    PageBackend,
    describe_enabling,
    open_recorder,
)
from rcmservo.cli.run_options import LabOptions
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import RcmServoError
from rcmservo.hardware.device_kinds import open_arm, open_camera
from rcmservo.interfaces import Target
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.frame_ring import FrameRing, RecordingCamera, RingCamera
from rcmservo.live.remote_stop import RemotelyStoppableArm, RemoteStop
from rcmservo.live.servo_process import FRAME_TIMEOUT_S, HeartbeatPlant, NoFrames, Session
from rcmservo.live.unchecked_rig_speed import reduce_speed
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.loop.plant import Plant
from rcmservo.page.channels import PageChannels
from rcmservo.page.enabling import await_enable
from rcmservo.page.messages import Note
from rcmservo.page.operator import PageOperator
from rcmservo.page.prompts import PagePrompts
from rcmservo.page.settings import SelectedSettings, without_limit
from rcmservo.recording.reader import RECORD
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers


@contextmanager
def open_hardware(options: LabOptions) -> Generator[PageBackend]:
    """Yield the devices of a rig file as the backend of the page; a session opens them."""
    lab, speed_scale = options.lab, find_allowed_speed_scale(options)
    chosen = SelectedSettings(options.servo, without_limit if speed_scale == 1.0 else reduce_speed)
    with closing(open_camera(lab)) as camera:
        width, height = measure_image_size(camera)
    context = get_context("spawn")
    ring, remote_stop = FrameRing(context, width, height), RemoteStop(context)

    def session(channels: PageChannels, folder: Path) -> Session:
        remote_stop.reset()
        limited, record = chosen.limited, folder / RECORD
        stop_hint = "STOP switches the drive off; keep the emergency stop of the arm within reach."
        limits = describe_speed_limits(options, limited, speed_scale)
        announcement = f"{describe_enabling(limited)} {limits} {stop_hint}"
        preparation = PagePreparation(channels, limited, lab, announcement)
        description = describe_hardware_run(options, SESSION_DURATION_S, speed_scale)
        return Session(
            limited,
            SESSION_DURATION_S,
            arm=partial(connect_stoppable_arm, lab, remote_stop, channels),
            camera=partial(open_recording_camera, lab, ring),
            tracker=partial(ColourMarkers, lab.markers),
            recorder=partial(open_recorder, record, description),
            target=partial(await_enable_at_page, preparation),
            operator=partial(PageOperator, channels, chosen, options.teaching_frames),
            images_per_s=RECORDED_IMAGES_PER_S,
            consent=require_drive_off,
        )

    title, setup = f"arm and camera of {options.rig}", describe_target_setup(lab, width, height)
    if speed_scale < 1.0:
        title += f", at {100.0 * speed_scale:g} % of the speed until `rig check` passes"
    switch_off, shown_camera = remote_stop.switch_off, partial(RingCamera, ring)
    yield PageBackend(title, shown_camera, session, switch_off, setup, chosen, refuse_disturbance)


@dataclass(frozen=True)
class PagePreparation:
    """Preparation of a session with the page's operator; it is passed to the servo process.

    Parameters
    ----------
    channels : PageChannels
        Channels to the page.
    servo : Servo
        Servo that moves the arm.
    lab : RigDescription
        Lab with its devices.
    motion_announcement : str
        Announcement of the motion that follows once the drive is on.
    """

    channels: PageChannels
    servo: Servo
    lab: RigDescription
    motion_announcement: str


def await_enable_at_page(preparation: PagePreparation, plant: Plant) -> Target:
    """Define the joint values if needed, and wait until the operator enables the drive."""
    assert isinstance(plant, HeartbeatPlant)
    require_drive_off(plant)
    if not get_lab_arm(plant).is_homed():
        define_joints(PagePrompts(preparation.channels, plant), plant, preparation.lab)
    return await_enable(
        preparation.channels, preparation.servo, preparation.motion_announcement, plant
    )


def connect_stoppable_arm(
    lab: RigDescription, remote_stop: RemoteStop, channels: PageChannels
) -> RemotelyStoppableArm:
    """Connect to the arm, so that STOP disables it."""
    return RemotelyStoppableArm(open_arm(lab), remote_stop, partial(report_drive_off, channels))


def report_drive_off(channels: PageChannels, reason: str) -> None:
    """Report to the page why the drive went off by itself."""
    channels.status.send(Note(f"the arm: {reason}"))


def open_recording_camera(lab: RigDescription, ring: FrameRing) -> RecordingCamera:
    """Open the camera, whose frames the page displays as well."""
    return RecordingCamera(open_camera(lab), ring)


def measure_image_size(camera: LabCamera) -> tuple[int, int]:
    """Return the width and height of a camera's images in px."""
    for _ in ticks(WallClock(), duration=FRAME_TIMEOUT_S):
        frame = camera.latest()
        if frame is not None and frame.image is not None:
            height, width = frame.image.shape[:2]
            return width, height
    message = f"the camera has delivered no image for {FRAME_TIMEOUT_S:g} s"
    raise NoFrames(": ".join(filter(None, (message, camera.counts().trouble))))


def refuse_disturbance(disturbance: str) -> str:
    """Refuse a disturbance, which only a simulated lab offers."""
    raise RcmServoError("disturbances are available on a simulated arm only")
