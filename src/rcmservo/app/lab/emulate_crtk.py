"""`rcmservo emulate crtk`: an arm that is not there, on ROS topics, with its camera's pictures."""

import threading
import time
from collections.abc import Generator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Literal

from rcmservo.app.preparing import simulator
from rcmservo.app.terminal import console
from rcmservo.config.rig_file import Lab
from rcmservo.hardware.crtk.device import STEP, CrtkDevice
from rcmservo.hardware.crtk.messages import PlainImage, Topic
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.crtk.transport import Transport, opened
from rcmservo.interfaces import Camera
from rcmservo.live.child import Child
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.realtime import realtime

PICTURES = Topic("camera/image_raw", PlainImage, lossy=True)
LOOK = 0.002
"""s between two looks for a new picture."""


@dataclass(frozen=True)
class RosOptions:
    """Where an arm on ROS topics is."""

    ros: Literal[2, 1] = 2
    """Which ROS crtk speaks: 2, or 1 by the master that ROS_MASTER_URI names."""
    namespace: str = "PSM1"
    """Of crtk: the arm's name, before all of its topics."""
    domain: int = 0
    """Of crtk: ROS 2's domain."""
    interface: str = "lo"
    """Of crtk: the network interface that ROS 2 is spoken on; lo is within this computer."""


def emulate_crtk(options: RosOptions, seed: int, lab: Lab) -> int:
    """Be the arm until Ctrl-C; the exit code is 0."""
    where = CrtkSettings(options.namespace, options.ros, options.domain, options.interface)
    with (
        closing(opened(where.ros, where.domain, where.interface)) as transport,
        simulated(transport, where.namespace, seed, lab) as device,
    ):
        on = f"domain {where.domain}, {where.interface}" if where.ros == 2 else "its master"
        words = f"emulated CRTK arm {where.namespace} on ROS {where.ros} ({on}), simulated arm"
        console(False).print(f"{words}, seed {seed}; Ctrl-C ends it", soft_wrap=True)
        try:
            serve(device)
        except KeyboardInterrupt:
            return 0
    return 0


@contextmanager
def simulated(transport: Transport, namespace: str, seed: int, lab: Lab) -> Generator[CrtkDevice]:
    """A simulated arm as a device, and its camera on a topic beside it."""
    with simulator("emulate"):
        from rcmservo.sim.processes.camera_process import film
        from rcmservo.sim.processes.motion_log import MotionLog
        from rcmservo.sim.rate_joints import SimulatedJoints
        from rcmservo.sim.rig import Rig
        from rcmservo.sim.rig_file import rig_settings

    context, settings = get_context("spawn"), rig_settings(lab)
    log, ring = MotionLog(context), FrameRing(context, settings.width, settings.height)
    joints = SimulatedJoints(Rig(seed, settings, pictures=False).truth.arm, log)
    limits, now = lab.mechanism.limits, time.monotonic_ns()
    device = CrtkDevice(joints, limits, transport, namespace, now, time.time_ns)
    with (
        closing_child(Child(context, film, seed, settings, log, ring)) as camera,
        showing(RingCamera(ring), transport, PICTURES.under(namespace)),
    ):
        camera.hear()
        yield device


@contextmanager
def closing_child(child: Child) -> Generator[Child]:
    """End a process in the end."""
    try:
        yield child
    finally:
        child.end()


@contextmanager
def showing(camera: Camera, transport: Transport, topic: Topic[PlainImage]) -> Generator[None]:
    """Send a camera's pictures meanwhile, in a thread."""
    over = threading.Event()
    transport.offer(topic)

    def show() -> None:
        last = None
        while not over.wait(LOOK):
            frame = camera.latest()
            if frame is None or frame is last or frame.image is None:
                continue
            last, (height, width, _) = frame, frame.image.shape
            stamp = frame.exposure + time.time_ns() - time.monotonic_ns()
            image = frame.image.tobytes()
            said = PlainImage(stamp, height, width, "bgr8", 0, 3 * width, image)
            transport.publish(topic, said)

    thread = threading.Thread(target=show, name="pictures", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def serve(device: CrtkDevice) -> None:
    """Let a device live in wall time, until Ctrl-C."""
    with realtime():
        while True:
            now = time.monotonic_ns()
            device.turn(now)
            time.sleep((STEP - now % STEP) * 1e-9)
