"""The emulated controller in a process of its own."""

import os
import re
import signal
import subprocess
import sys

from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.method.kinematics import SphericalRcm


class Emulated:
    """`rcmservo emulate galil`, on a port that is free; `close` it at the end."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "rcmservo", "emulate", "galil", "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        said = re.search(r"127\.0\.0\.1:(\d+)", self.process.stdout.readline())
        assert said is not None
        self.port = int(said[1])

    def arm(self) -> GalilArm:
        """The driver of the arm behind it."""
        settings = GalilSettings("127.0.0.1", (50000.0, 50000.0, 500.0), self.port)
        return GalilArm(settings, SphericalRcm().limits)

    def close(self) -> None:
        os.kill(self.process.pid, signal.SIGCONT)
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=30.0)
