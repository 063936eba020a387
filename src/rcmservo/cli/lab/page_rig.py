"""A laboratory's arm and camera behind the operator's page.

rig file ─► camera, for the size of its pictures ─► sessions
                                                    arm: leashed for STOP; camera: seen by the page

The person at the page is the one at the arm: who says where it stands, and switches its drive on.
"""

from collections.abc import Generator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from rcmservo.cli.lab.hardware_prompts import (
    define,
    lab_arm,
    require_drive_off,
    target_setup_for_size,
)
from rcmservo.cli.lab.live_on_hardware import (
    allowed_speed_scale,
    describe_speed_limits,
    hardware_description,
)
from rcmservo.cli.lab.page_backend import (
    RECORDED_IMAGES_PER_S,
    SESSION_DURATION_S,
    Behind,
    enable_announcement,
    open_recorder,
)
from rcmservo.cli.lab_options import LabOptions
from rcmservo.config.rig_file import Lab
from rcmservo.errors import RcmServoError
from rcmservo.hardware.devices import open_arm, open_camera
from rcmservo.interfaces import Target
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.frame_ring import FrameRing, RecordingCamera, RingCamera
from rcmservo.live.reduced_speed import reduce_speed
from rcmservo.live.remote_stop import RemotelyStoppableArm, RemoteStop
from rcmservo.live.servo_process import FRAME_TIMEOUT_S, HeartbeatPlant, NoFrames, Session
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.loop.plant import Plant
from rcmservo.page.channels import Desk
from rcmservo.page.enabling import await_enable
from rcmservo.page.messages import Note
from rcmservo.page.operator import PageOperator
from rcmservo.page.prompts import PagePerson
from rcmservo.page.settings import Chosen, as_set
from rcmservo.recording.reader import RECORD
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers


@contextmanager
def open_hardware(options: LabOptions) -> Generator[Behind]:
    """The devices of a rig file, and the servo as the options have it."""
    lab, share = options.lab, allowed_speed_scale(options)
    chosen = Chosen(options.servo, as_set if share == 1.0 else reduce_speed)
    with closing(open_camera(lab)) as camera:
        width, height = image_size(camera)
    context = get_context("spawn")
    ring, leash = FrameRing(context, width, height), RemoteStop(context)

    def session(desk: Desk, folder: Path) -> Session:
        leash.reset()
        limited, record = chosen.limited, folder / RECORD
        stop = "STOP switches the drive off; have the emergency stop of the arm at hand."
        intent = f"{enable_announcement(limited)} {describe_speed_limits(options, limited, share)} {stop}"
        return Session(
            limited,
            SESSION_DURATION_S,
            arm=partial(connect_stoppable_arm, lab, leash, desk),
            camera=partial(open_recording_camera, lab, ring),
            tracker=partial(ColourMarkers, lab.markers),
            recorder=partial(
                open_recorder, record, hardware_description(options, SESSION_DURATION_S, share)
            ),
            target=partial(await_enable_at_page, PagePreparation(desk, limited, lab, intent)),
            operator=partial(PageOperator, desk, chosen, options.teaching_frames),
            pictures=RECORDED_IMAGES_PER_S,
            consent=require_drive_off,
        )

    slow = "" if share == 1.0 else f", at {100.0 * share:g} % of the speed until `rig check` passes"
    title, setup = (
        f"arm and camera of {options.rig}{slow}",
        target_setup_for_size(lab, width, height),
    )
    yield Behind(
        title,
        partial(RingCamera, ring),
        session,
        leash.switch_off,
        setup,
        chosen,
        refuse_disturbance,
    )


@dataclass(frozen=True)
class PagePreparation:
    """What is to be done with the help of the page's person; it passes to the servo's process.

    Parameters
    ----------
    desk : Desk
        Where the person is heard.
    servo : Servo
        What is going to move the arm.
    lab : Lab
        The laboratory with its devices.
    intent : str
        What is going to happen once the drive is on, in words.
    """

    desk: Desk
    servo: Servo
    lab: Lab
    intent: str


def await_enable_at_page(at: PagePreparation, plant: Plant) -> Target:
    """Where the arm stands, if it does not know; then wait until the person wants the drive on."""
    assert isinstance(plant, HeartbeatPlant)
    require_drive_off(plant)
    if not lab_arm(plant).homed():
        define(PagePerson(at.desk, plant), plant, at.lab)
    return await_enable(at.desk, at.servo, at.intent, plant)


def connect_stoppable_arm(lab: Lab, leash: RemoteStop, desk: Desk) -> RemotelyStoppableArm:
    """Connect to the arm, so that STOP reaches it."""
    return RemotelyStoppableArm(open_arm(lab), leash, partial(report_drive_off, desk))


def report_drive_off(desk: Desk, why: str) -> None:
    """Tell the page why the drive went off by itself."""
    desk.said.put(Note(f"the arm: {why}"))


def open_recording_camera(lab: Lab, ring: FrameRing) -> RecordingCamera:
    """Open the camera, so that the page sees what it sees."""
    return RecordingCamera(open_camera(lab), ring)


def image_size(camera: LabCamera) -> tuple[int, int]:
    """Width and height px of a camera's pictures."""
    for _ in ticks(WallClock(), duration=FRAME_TIMEOUT_S):
        frame = camera.latest()
        if frame is not None and frame.image is not None:
            height, width = frame.image.shape[:2]
            return width, height
    why = camera.counts().trouble
    raise NoFrames(f"the camera has given no picture for {FRAME_TIMEOUT_S:g} s{why and ': ' + why}")


def refuse_disturbance(what: str) -> str:
    """Nothing goes wrong here on request."""
    raise RcmServoError("trouble can be asked for of a simulated arm alone")
