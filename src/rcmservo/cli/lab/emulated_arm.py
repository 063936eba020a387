"""Simulated arm of an emulated controller, in wall time, and its camera if requested.

emulate ─┬─► camera process    renders the logged motion into shared memory
         └─► device process    sends the frames as a real camera does
"""

import contextlib
import time
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import RcmServoError
from rcmservo.hardware.crtk.device import RateJoints
from rcmservo.hardware.galil.emulator.motors import Motors
from rcmservo.live.child_process import ChildProcess, receive_from_parent
from rcmservo.live.frame_ring import FrameRing, RingCamera


class EmulatedArm:
    """Simulated arm and its camera, as a context manager that ends the camera processes.

    Parameters
    ----------
    seed : int
        Seed that draws the poses of arm and camera.
    lab : RigDescription
        Lab with mechanism, drives and scene.
    """

    def __init__(self, seed: int, lab: RigDescription) -> None:
        from rcmservo.sim import Rig
        from rcmservo.sim.rig_file import read_rig_settings

        self._seed, self._settings = seed, read_rig_settings(lab)
        self._rig = Rig(seed, self._settings, pictures=False)
        self._arm = self._rig.truth.arm
        self._stack, self._context = contextlib.ExitStack(), get_context("spawn")
        self._ring: FrameRing | None = None

    def __enter__(self) -> "EmulatedArm":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def ruler_measurements(self) -> str:
        """Sentence on the initial joint values and tool lengths, which `rig check` requests."""
        q = self._rig.scene.start
        p1, p2 = self._rig.body.points(q)[:2]
        return (
            f"the arm is at {q[0]:.4f} {q[1]:.4f} {q[2]:.2f} (rad, rad, mm). By ruler, "
            f"its markers are {np.linalg.norm(p2 - p1):.1f} mm apart, and marker 1 is "
            f"{np.linalg.norm(p1):.1f} mm from the RCM"
        )

    def start_camera(self, send: Callable[..., None], *arguments: Any) -> str:
        """Start a process that sends the camera's frames, and return its address.

        Parameters
        ----------
        send : Callable
            Function that the process runs: `send_mjpeg`, `send_gige` or `send_images`.
        *arguments
            Arguments of `send` between the frame ring and the pipe.
        """
        filming = None if self._ring else self._start_filming()
        sending = self._start_child(send, self._ring, *arguments)
        if filming is not None:
            filming.receive()
        return sending.receive()

    def make_joints(self) -> RateJoints:
        """Place the arm at its start and return it as joints with velocity drives and brakes."""
        from rcmservo.sim.motor_interface import SimulatedJoints

        self._place_at_start()
        return SimulatedJoints(self._arm)

    def make_motors(self, counts: tuple[float, float, float], axes: int) -> Motors:
        """Place the arm at its start and return it as motors with encoders."""
        from rcmservo.sim.motor_interface import SimulatedMotors

        self._place_at_start()
        return SimulatedMotors(self._arm, np.array(counts), axes)

    def _place_at_start(self) -> None:
        """Place the arm at its start and set its time to the wall clock."""
        from rcmservo.sim.arm import PHYSICS_STEP_NS

        self._arm.time = time.monotonic_ns() // PHYSICS_STEP_NS * PHYSICS_STEP_NS
        self._arm.place(self._rig.scene.start)

    def _start_filming(self) -> ChildProcess:
        """Start and return the camera process, which renders into the frame ring."""
        from rcmservo.sim.arm import PHYSICS_STEP_NS
        from rcmservo.sim.processes.camera_process import run_camera_process
        from rcmservo.sim.processes.motion_log import MotionLog

        log = MotionLog(self._context)
        no_rates, arm = np.zeros(3), self._arm

        def log_joints() -> None:
            """Log the joints after the previous step."""
            log.add(arm.time - PHYSICS_STEP_NS, time.monotonic_ns(), 0, True, no_rates, arm.q_true)

        log_joints()
        arm.before_step = log_joints
        self._ring = FrameRing(self._context, self._settings.width, self._settings.height)
        return self._start_child(run_camera_process, self._seed, self._settings, log, self._ring)

    def _start_child(self, work: Callable[..., None], *arguments: Any) -> ChildProcess:
        """Start a process that ends with the arm."""
        child = ChildProcess(self._context, work, *arguments)
        self._stack.callback(child.end)
        return child


def send_mjpeg(ring: FrameRing, port: int, control: Connection) -> None:
    """Serve a camera's frames as Motion JPEG until the parent sends a message or is gone."""
    from rcmservo.hardware.cameras.emulated.mjpeg_server import MjpegServer

    _run_camera(lambda: MjpegServer(RingCamera(ring), port), control)


def send_gige(ring: FrameRing, control: Connection) -> None:
    """Serve a camera's frames by GigE Vision until the parent sends a message or is gone."""
    from rcmservo.hardware.cameras.emulated.gige_camera import GigeCamera

    height, width, _ = ring.shape
    _run_camera(lambda: GigeCamera(RingCamera(ring), width, height), control)


def _run_camera(open_camera: Callable[[], Any], control: Connection) -> None:
    """Open a camera, report its address or the error, and wait for the parent."""
    try:
        camera = open_camera()
    except RcmServoError as error:
        control.send(RcmServoError(str(error)))
        return
    with contextlib.closing(camera):
        control.send(camera.address)
        receive_from_parent(control)
