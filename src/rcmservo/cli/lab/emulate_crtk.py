"""`rcmservo emulate crtk`: an emulated arm on ROS topics, with the images of its camera.

CRTK (collaborative robotics toolkit) is a convention for the names and types of these topics.
"""

import time
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Annotated

from rcmservo.cli.lab.emulated_arm import EmulatedArm
from rcmservo.cli.terminal import open_console
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import RcmServoError, require_extra
from rcmservo.hardware.crtk.device import STEP_NS, CrtkDevice
from rcmservo.hardware.crtk.messages import IMAGE_TOPIC, PlainImage
from rcmservo.hardware.crtk.settings import NAMESPACE, RosConnection
from rcmservo.hardware.crtk.transport import open_transport
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.realtime import apply_realtime_settings

IMAGE_POLL_S = 0.002
"""Interval in s at which the camera is polled for a new image."""


@dataclass(frozen=True, kw_only=True)
class RosOptions(RosConnection):
    """Options of `emulate crtk` only.

    Parameters
    ----------
    namespace : str
        crtk: name of the arm, the prefix of all its topics.
    """

    namespace: Annotated[str, NAMESPACE] = "PSM1"


def emulate_crtk(connection: RosOptions, seed: int, lab: RigDescription) -> int:
    """Emulate the arm until Ctrl-C and return the exit code 0."""
    with require_extra("emulate", "sim"):
        arm = EmulatedArm(seed, lab)
    with arm, closing(open_transport(connection)) as transport:
        arm.start_camera(send_images, connection)
        limits, joints = lab.mechanism.limits, arm.make_joints()
        name, ros, now_ns = connection.namespace, connection.ros, time.monotonic_ns()
        device = CrtkDevice(joints, limits, transport, name, now_ns, time.time_ns)
        network = f" (domain {connection.domain}, {connection.interface})" if ros == 2 else ""
        arm_name = f"emulated CRTK arm {name} on ROS {ros}{network}, simulated arm"
        open_console().print(f"{arm_name}, seed {seed}; Ctrl-C ends it", soft_wrap=True)
        try:
            run_device(device)
        except KeyboardInterrupt:
            return 0
    return 0


def send_images(ring: FrameRing, connection: RosOptions, control: Connection) -> None:
    """Publish a camera's images on a topic until the parent sends a message or is gone."""
    try:
        transport = open_transport(connection)
    except RcmServoError as error:
        control.send(RcmServoError(str(error)))
        return
    camera, sent_frame, topic = RingCamera(ring), None, IMAGE_TOPIC.under(connection.namespace)
    with closing(transport):
        transport.offer(topic)
        control.send(topic.name)
        while not control.poll(IMAGE_POLL_S):
            frame = camera.latest()
            if frame is None or frame is sent_frame or frame.image is None:
                continue
            sent_frame, (height, width, _) = frame, frame.image.shape
            stamp_ns = frame.exposure + time.time_ns() - time.monotonic_ns()
            data = frame.image.tobytes()
            message = PlainImage(stamp_ns, height, width, "bgr8", 0, 3 * width, data)
            transport.publish(topic, message)


def run_device(device: CrtkDevice) -> None:
    """Run a device in wall time until Ctrl-C."""
    with apply_realtime_settings():
        while True:
            now_ns = time.monotonic_ns()
            device.update(now_ns)
            time.sleep((STEP_NS - now_ns % STEP_NS) * 1e-9)
