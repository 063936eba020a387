"""Laboratory of emulated devices for benchmarks: `rcmservo emulate galil`, and live runs over TCP.

Controller and camera run in separate processes. To teach the target and to return the tool, a
second host jogs the arm while the servo's driver has not switched it on.
"""

import contextlib
import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.device_kinds import open_arm, open_camera
from rcmservo.interfaces import Arm, Floats, Target
from rcmservo.live.servo_process import Session
from rcmservo.loop.plant import Plant
from rcmservo.loop.teach import teach
from rcmservo.recording.writer import Recorder
from rcmservo.rig.lazy_rig import LazyRig
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig
from rcmservo.sim.tool_body import ToolBody
from rcmservo.tracking import ColourMarkers

COUNTS = np.array([50000.0, 50000.0, 500.0])
CAMERAS = {
    "mjpeg": (["--mjpeg", "0"], {"kind": "opencv", "latency": 0.03}),
    "gige": (["--gige"], {"kind": "aravis", "latency": 0.03}),
}
"""Options of the emulator and section [camera] of the rig file, by kind of camera. The latencies
are measured."""
PATIENCE = 30.0
"""Time limit (s) for an answer."""
SPEEDS = "25000,25000,25000"
"""Speeds (counts/s) of motions by the second host; the driver's JG overwrites them."""
SETTLED = 0.3
"""Time (s) after a motion until frames show the tool at rest."""


class Host:
    """Second host of the controller, with plain text commands over TCP."""

    def __init__(self, port: int) -> None:
        self._wire = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
        self._wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(self, *commands: str) -> list[str]:
        """Send commands and return their replies."""
        self._wire.sendall((";".join(commands) + "\r").encode())
        heard = b""
        while heard.count(b":") + heard.count(b"?") < len(commands):
            more = self._wire.recv(4096)
            if not more:
                raise ConnectionError("the emulator has closed the connection")
            heard += more
        if b"?" in heard:
            raise RuntimeError(f"the controller rejected a command of {commands}")
        return [part.strip() for part in heard.decode("latin-1").split(":")[:-1]]

    def numbers(self, command: str) -> Floats:
        return np.array([float(part) for part in self.ask(command)[0].replace(",", " ").split()])

    def places(self) -> Floats:
        """Return the encoder positions (3,) of the joints in counts."""
        return self.numbers("TP ABC")

    def off(self) -> bool:
        """Return whether all three motors are off."""
        return bool(self.numbers("MG _MOA,_MOB,_MOC").all())

    def go(self, places: Floats) -> None:
        """Move the joints to encoder positions (3,), wait until they are at rest, motors off."""
        there = ",".join(str(round(place)) for place in places)
        self.ask("SH ABC", f"SP {SPEEDS}", f"PA {there}", "BG ABC")
        while self.numbers("MG _BGA,_BGB,_BGC").any():
            time.sleep(0.01)
        time.sleep(SETTLED)
        self.ask("MO ABC")

    def close(self) -> None:
        self._wire.close()


class EmulatedLab:
    """Emulator with one of `CAMERAS` and a scene from a seed; a context manager."""

    def __init__(self, seed: int, camera: str) -> None:
        options, self._camera = CAMERAS[camera]
        command = [sys.executable, "-m", "rcmservo", "emulate", "galil", "--port", "0", *options]
        self._process = subprocess.Popen(
            [*command, "--seed", str(seed)], stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        words = self._process.stdout.readline()
        said = re.search(r":(\d+), .* camera at (?:GigE Vision )?([^\s,]+), seed", words)
        assert said is not None, words
        self.port, self._address = int(said[1]), said[2]
        self.pid = self._process.pid
        rig = Rig(seed, pictures=False)
        self.start, self.target = rig.scene.start, rig.scene.target
        self.host = Host(self.port)

    def __enter__(self) -> "EmulatedLab":
        return self

    def __exit__(self, *_: object) -> None:
        self.host.close()
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def lab(self, port: int = 0) -> RigDescription:
        """Return the rig file, with another port of the controller if one is given."""
        where = "source" if self._camera["kind"] == "opencv" else "address"
        arm = {"kind": "galil", "address": "127.0.0.1", "port": port or self.port}
        return replace(
            RigDescription(),
            devices={
                "arm": {**arm, "counts": COUNTS.tolist()},
                "camera": {**self._camera, where: self._address},
            },
        )

    def session(self, servo: Servo, duration: float, record: Path, port: int = 0) -> Session:
        """Return a live session of `duration` s, recorded in a new file."""
        lab = self.lab(port)
        shown = partial(teach_by_jog, self.port, self.target * COUNTS, self.start * COUNTS)
        return Session(
            servo,
            duration,
            LazyRig(
                partial(_homed, lab, self.start),
                partial(open_camera, lab),
                partial(ColourMarkers, lab.markers),
                lab.mechanism,
                lab.tool,
            ),
            recorder=partial(Recorder, record, {}),
            target=shown,
        )

    def error(self) -> float:
        """Return the pose error ‖p₂ − p_d‖ in mm, from the encoders."""
        body = ToolBody(RigDescription().mechanism, RigDescription().tool)
        now = self.host.places() / COUNTS
        ends = [body.points(q)[1] for q in (now, self.target)]
        return float(np.linalg.norm(ends[0] - ends[1]))


def teach_by_jog(port: int, target: Floats, start: Floats, plant: Plant) -> Target:
    """Teach the target at encoder positions `target` (3,), then move the tool to the start."""
    with contextlib.closing(Host(port)) as host:
        host.go(target)
        shown = teach(plant, frames=30)
        host.go(start)
    return shown


def _homed(lab: RigDescription, start: Floats) -> Arm:
    arm = open_arm(lab)
    if not arm.is_homed():
        arm.set_position(start)
    return arm
