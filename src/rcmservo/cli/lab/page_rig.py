"""Arm and camera of a lab for the operator's page.

The camera is opened once to read the size of its images, and closed. Each session then opens arm
and camera in the servo process; STOP on the page switches the drive off, and the page shows the
camera's frames.

The operator of the page must stand at the arm: this operator moves the arm by hand to define its
joint values, and enables the drive.
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
)
from rcmservo.cli.lab.live_on_hardware import describe_speed_limits
from rcmservo.cli.lab.page_backend import (
    RECORDED_IMAGES_PER_S,
    SESSION_DURATION_S,
    PageBackend,
    describe_enabling,
    open_recorder,
)
from rcmservo.cli.run_description import describe_run
from rcmservo.cli.run_options import LabOptions
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import RcmServoError
from rcmservo.hardware.device_kinds import open_arm, open_camera
from rcmservo.hardware.lab_rig import LabRig
from rcmservo.interfaces import Target
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.frame_ring import FrameRing, RecordingCamera, RingCamera
from rcmservo.live.remote_stop import RemotelyStoppableArm, RemoteStop
from rcmservo.live.servo_process import FIRST_FRAME_TIMEOUT_S, HeartbeatPlant, NoFrames, Session
from rcmservo.live.unchecked_rig_speed import reduce_speed
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.loop.plant import Plant
from rcmservo.page.channels import PageChannels
from rcmservo.page.enabling import await_enable
from rcmservo.page.messages import Note
from rcmservo.page.operator import PageOperator
from rcmservo.page.prompts import PagePrompts
from rcmservo.page.selected_settings import SelectedSettings, without_limit
from rcmservo.recording.reader import RECORD
from rcmservo.rig.rig import require_drive_off
from rcmservo.servo.servo import Servo


@contextmanager
def open_hardware(options: LabOptions, rig: LabRig) -> Generator[PageBackend]:
    """Yield the arm and camera of a rig file as the backend of the page.

    First the camera is opened to read the size of its images, and closed. Each session then opens
    both devices in the servo process.

    Parameters
    ----------
    options : LabOptions
        Options of the command.
    rig : LabRig
        Arm and camera of the rig file, not connected.

    Yields
    ------
    PageBackend
        Backend of the page.

    Raises
    ------
    NoFrames
        If the camera delivers no image in time.
    """
    selected_settings = SelectedSettings(
        options.servo, without_limit if rig.speed_scale == 1.0 else reduce_speed
    )
    with closing(open_camera(rig.description)) as camera:
        width, height = read_image_size(camera)
    spawn_context = get_context("spawn")
    frame_ring = FrameRing(spawn_context, width, height)
    remote_stop = RemoteStop(spawn_context)

    def make_session(channels: PageChannels, folder: Path) -> Session:
        remote_stop.reset()
        limited_servo, record_path = selected_settings.limited, folder / RECORD
        stop_hint = "STOP switches the drive off; keep the emergency stop of the arm within reach."
        limits = describe_speed_limits(rig, limited_servo)
        announcement = f"{describe_enabling(limited_servo)} {limits} {stop_hint}"
        preparation = PagePreparation(channels, limited_servo, rig.description, announcement)
        run_description = rig.describe() | describe_run(options, SESSION_DURATION_S)
        return Session(
            limited_servo,
            SESSION_DURATION_S,
            LabRig(
                rig.path,
                rig.description,
                rig.digest,
                arm=partial(connect_stoppable_arm, remote_stop, channels),
                camera=partial(open_shared_camera, frame_ring),
            ),
            recorder=partial(open_recorder, record_path, run_description),
            target=partial(prepare_at_page, preparation),
            operator=partial(PageOperator, channels, selected_settings, options.teaching_frames),
            images_per_s=RECORDED_IMAGES_PER_S,
            consent=require_drive_off,
        )

    title = f"arm and camera of {rig.path}"
    if rig.speed_scale < 1.0:
        title += f", at {100.0 * rig.speed_scale:g} % of the speed until `rig check` passes"
    yield PageBackend(
        title,
        camera=partial(RingCamera, frame_ring),
        session=make_session,
        switch_off=remote_stop.switch_off,
        setup=describe_target_setup(rig.description, width, height),
        servo_settings=selected_settings,
        start_disturbance=refuse_disturbance,
    )


@dataclass(frozen=True)
class PagePreparation:
    """Arguments of `prepare_at_page`, which are passed to the servo process.

    Parameters
    ----------
    channels : PageChannels
        Channels to the page.
    servo : Servo
        Servo that moves the arm.
    rig_description : RigDescription
        Contents of the rig file.
    motion_announcement : str
        Text for the operator about what happens once the drive is on.
    """

    channels: PageChannels
    servo: Servo
    rig_description: RigDescription
    motion_announcement: str


def prepare_at_page(preparation: PagePreparation, plant: Plant) -> Target:
    """Wait until the operator at the page enables the drive, and return the first target.

    If the arm does not know its joint values, the operator first defines them at the page.

    Parameters
    ----------
    preparation : PagePreparation
        Channels to the page, servo, rig and announcement.
    plant : Plant
        Plant of the servo process.

    Returns
    -------
    Target
        Present pose of the tool.

    Raises
    ------
    NotReady
        If the drive is on already, because another program may move the arm.
    Stopped
        If a stop is requested.
    """
    assert isinstance(plant, HeartbeatPlant)
    channels, rig_description = preparation.channels, preparation.rig_description
    require_drive_off(plant)
    if not get_lab_arm(plant).is_homed():
        define_joints(PagePrompts(channels, plant), plant, rig_description)
    return await_enable(channels, preparation.servo, preparation.motion_announcement, plant)


def connect_stoppable_arm(
    remote_stop: RemoteStop, channels: PageChannels, lab: RigDescription
) -> RemotelyStoppableArm:
    """Connect to the arm, whose drive STOP on the page then switches off."""
    arm = open_arm(lab)
    return RemotelyStoppableArm(arm, remote_stop, partial(report_drive_off, channels))


def report_drive_off(channels: PageChannels, reason: str) -> None:
    """Send the page the reason why the drive went off without a request."""
    channels.status.send(Note(f"the arm's drive is off: {reason}"))


def open_shared_camera(frame_ring: FrameRing, lab: RigDescription) -> RecordingCamera:
    """Open the camera so that its frames are also available to the page, in `frame_ring`."""
    return RecordingCamera(open_camera(lab), frame_ring)


def read_image_size(camera: LabCamera) -> tuple[int, int]:
    """Return the width and height (px) of the first image that a camera delivers.

    Raises
    ------
    NoFrames
        If no image arrives within `FIRST_FRAME_TIMEOUT_S`; the message ends with the camera's
        trouble, if it reports any.
    """
    for _ in ticks(WallClock(), duration=FIRST_FRAME_TIMEOUT_S):
        frame = camera.latest()
        if frame is not None and frame.image is not None:
            height, width = frame.image.shape[:2]
            return width, height
    message = f"the camera has delivered no image for {FIRST_FRAME_TIMEOUT_S:g} s"
    raise NoFrames(": ".join(filter(None, (message, camera.counts().trouble))))


def refuse_disturbance(disturbance: str) -> str:
    """Raise `RcmServoError`: only a simulated lab has disturbances."""
    raise RcmServoError("disturbances are available on a simulated arm only")
