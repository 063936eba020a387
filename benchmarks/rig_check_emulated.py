"""A rig file that is wrong, and the emulated controller with its camera, over TCP in wall time.

The person beside it sees what the encoders tell to a host of their own, whatever the file says.
"""

import threading
from collections.abc import Generator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
from emulated_lab import COUNTS, EmulatedLab, Host
from rig_check_lab import Mistake, Onlooker

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.check import CheckReport, check, warm_up
from rcmservo.bringup.motion import PATIENCE, Mover
from rcmservo.cli.lab.rig_check import trouble
from rcmservo.config.rig_file import Lab
from rcmservo.geometry.tool import RigidTool
from rcmservo.hardware.devices import open_arm, open_camera, read_wiring
from rcmservo.interfaces import Floats, Frame
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.realtime import realtime
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock
from rcmservo.loop.run_result import CameraAccount
from rcmservo.sim.rig import Rig
from rcmservo.tracking import ColourMarkers

LOOK = 0.01
"""s between two looks at the encoders."""


class Mirror:
    """A camera whose picture is mirrored."""

    def __init__(self, camera: LabCamera) -> None:
        self._camera = camera
        self._seen: Frame | None = None
        self._given: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self._camera.latest()
        if frame is not self._seen and frame is not None:
            assert frame.image is not None
            self._seen = frame
            self._given = replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))
        return self._given

    def counts(self) -> CameraAccount:
        return self._camera.counts()

    def close(self) -> None:
        self._camera.close()


class Watched:
    """The tool as somebody beside it sees it, who looks all the time."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.past = rig, list[Floats]()
        self.farthest = 0.0
        """mm that marker 2 went at most."""
        self.q_true = rig.scene.start
        self._over = threading.Event()

    @contextmanager
    def looking(self, port: int) -> Generator[None]:
        """Look meanwhile, from the tool's start on."""
        with closing(Host(port)) as host:
            thread = threading.Thread(target=self._look, args=(host,))
            thread.start()
            try:
                yield
            finally:
                self._over.set()
                thread.join()

    def _look(self, host: Host) -> None:
        start, zero = self.rig.scene.start, host.places()
        home = self.rig.body.points(start)[1]
        while not self._over.wait(LOOK):
            self.q_true = q = start + (host.places() - zero) / COUNTS
            self.past.append(q)
            gone = float(np.linalg.norm(self.rig.body.points(q)[1] - home))
            self.farthest = max(self.farthest, gone)


class WrongEmulatedLab:
    """All of it: the mistake stands in the rig file, or before the camera."""

    def __init__(self, mistake: Mistake, seed: int, camera: str) -> None:
        self._mistake, self._seed, self._camera = mistake, seed, camera
        self.rig = Rig(seed, pictures=False)
        self.arm = Watched(self.rig)
        self.person = Onlooker(self.arm, self.rig.settings.tool.spacing)

    def check(self) -> CheckReport:
        """Check it once."""
        wrong = self._mistake
        with ExitStack() as stack:
            emulated = stack.enter_context(EmulatedLab(self._seed, self._camera))
            lab = self._file(emulated.lab())
            robot = Robot(lab.mechanism, lab.tool, read_wiring(lab))
            warm_up(robot, lab.gate)
            clock, arm = WallClock(), open_arm(lab)
            stack.callback(arm.close)
            arm.define(emulated.start)
            eye = open_camera(lab)
            eye = Mirror(eye) if wrong.mirrored else eye
            stack.callback(eye.close)
            seen = stack.enter_context(TrackingThread(eye, ColourMarkers(lab.markers), clock))
            seen.wait_for(frames=2, patience=PATIENCE)
            silence, told = lab.thresholds.silence, partial(trouble, eye)
            mover = Mover(arm, seen, seen, clock, robot, lab.gate, silence, told)
            stack.enter_context(self.arm.looking(emulated.port))
            latency = float(lab.devices["camera"]["latency"])
            with realtime():
                return check(mover, self.person, robot, lab.thresholds, latency)

    def _file(self, lab: Lab) -> Lab:
        """The rig file with the mistake in it."""
        wrong, tool, mechanism = self._mistake, lab.tool, lab.mechanism
        assert isinstance(tool, RigidTool)
        counts = (COUNTS * wrong.factors).tolist()
        arm = {**lab.devices["arm"], "counts": counts, "axes": wrong.axes}
        zero = mechanism.insertion_zero + wrong.zero
        return replace(
            lab,
            mechanism=replace(mechanism, insertion_zero=zero),
            tool=replace(tool, spacing=tool.spacing * wrong.spacing),
            devices={**lab.devices, "arm": arm},
        )
