"""Emulated controller and camera, over TCP in wall time, with one error in the rig file.

The simulated operator observes the true motion: a second connection reads the encoders without the
rig file.
"""

import threading
from collections.abc import Generator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
from emulated_lab import COUNTS, EmulatedLab, Host
from rig_check_lab import Mistake, SimulatedOperator

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.check import CheckReport, check, warm_up
from rcmservo.bringup.motion import IDLE_TIMEOUT, Mover
from rcmservo.cli.lab.rig_check import find_camera_fault
from rcmservo.config.rig_file import RigDescription
from rcmservo.geometry.tool import RigidTool
from rcmservo.hardware.device_kinds import open_arm, open_camera, read_wiring
from rcmservo.interfaces import Floats, Frame
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock
from rcmservo.loop.run_result import CameraStatistics
from rcmservo.sim import Rig
from rcmservo.tracking import ColourMarkers

POLL_PERIOD_S = 0.01
"""Time (s) between two readings of the encoders."""


class Mirror:
    """Camera whose image is mirrored."""

    def __init__(self, camera: LabCamera) -> None:
        self._camera = camera
        self._newest: Frame | None = None
        self._delivered: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self._camera.latest()
        if frame is not self._newest and frame is not None:
            assert frame.image is not None
            self._newest = frame
            self._delivered = replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))
        return self._delivered

    def counts(self) -> CameraStatistics:
        return self._camera.counts()

    def close(self) -> None:
        self._camera.close()


class ObservedTool:
    """True motion of the tool, polled from the encoders in a thread."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.history = rig, list[Floats]()
        self.max_travel = 0.0
        """Largest travel (mm) of marker 2."""
        self.q_true = rig.scene.start
        self._over = threading.Event()

    @contextmanager
    def polling(self, port: int) -> Generator[None]:
        """Poll the encoders in the context, with the tool at its start at first."""
        with closing(Host(port)) as host:
            thread = threading.Thread(target=self._poll, args=(host,))
            thread.start()
            try:
                yield
            finally:
                self._over.set()
                thread.join()

    def _poll(self, host: Host) -> None:
        start, zero = self.rig.scene.start, host.places()
        home = self.rig.body.points(start)[1]
        while not self._over.wait(POLL_PERIOD_S):
            self.q_true = q = start + (host.places() - zero) / COUNTS
            self.history.append(q)
            travel = float(np.linalg.norm(self.rig.body.points(q)[1] - home))
            self.max_travel = max(self.max_travel, travel)


class FaultyEmulatedLab:
    """Emulated laboratory with a mistake in its rig file or its camera."""

    def __init__(self, mistake: Mistake, seed: int, camera: str) -> None:
        self._mistake, self._seed, self._camera = mistake, seed, camera
        self.rig = Rig(seed, pictures=False)
        self.arm = ObservedTool(self.rig)
        self.operator = SimulatedOperator(self.arm, self.rig.settings.tool.spacing)

    def check(self) -> CheckReport:
        """Run the check once."""
        mistake = self._mistake
        with ExitStack() as stack:
            emulated = stack.enter_context(EmulatedLab(self._seed, self._camera))
            lab = self._file(emulated.lab())
            robot = Robot(lab.mechanism, lab.tool, read_wiring(lab))
            warm_up(robot, lab.gate)
            clock, arm = WallClock(), open_arm(lab)
            stack.callback(arm.close)
            arm.set_position(emulated.start)
            camera = open_camera(lab)
            camera = Mirror(camera) if mistake.mirrored else camera
            stack.callback(camera.close)
            tracking = TrackingThread(camera, ColourMarkers(lab.markers), clock)
            tracker = stack.enter_context(tracking)
            tracker.wait_for(frames=2, timeout_s=IDLE_TIMEOUT)
            silence, fault = lab.thresholds.arm_timeout, partial(find_camera_fault, camera)
            mover = Mover(arm, tracker, tracker, clock, robot, lab.gate, silence, fault)
            stack.enter_context(self.arm.polling(emulated.port))
            latency = float(lab.devices["camera"]["latency"])
            with apply_realtime_settings():
                return check(mover, self.operator, robot, lab.thresholds, latency)

    def _file(self, lab: RigDescription) -> RigDescription:
        """Return the rig file with the mistake in it."""
        mistake, tool, mechanism = self._mistake, lab.tool, lab.mechanism
        assert isinstance(tool, RigidTool)
        counts = (COUNTS * mistake.factors).tolist()
        arm = {**lab.devices["arm"], "counts": counts, "axes": mistake.axes}
        zero = mechanism.insertion_zero + mistake.zero
        return replace(
            lab,
            mechanism=replace(mechanism, insertion_zero=zero),
            tool=replace(tool, spacing=tool.spacing * mistake.spacing),
            devices={**lab.devices, "arm": arm},
        )
