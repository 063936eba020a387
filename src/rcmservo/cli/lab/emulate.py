"""`rcmservo emulate`: a controller that is not there, with a simulated arm behind it."""

import contextlib
import time
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from rcmservo.cli.lab.emulate_crtk import RosOptions, emulate_crtk
from rcmservo.cli.lab.emulated_arm import EmulatedArm, send_gige, send_mjpeg
from rcmservo.cli.terminal import console
from rcmservo.config.rig_file import load_lab
from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import needing, require
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, Controller
from rcmservo.hardware.galil.emulator.faults import FAULT_KINDS, Fault
from rcmservo.hardware.galil.emulator.serial_port import SerialPort
from rcmservo.hardware.galil.emulator.server import Server
from rcmservo.live.realtime import realtime

AXES = 4
COUNTS = 50000.0, 50000.0, 500.0
"""Of a rad, rad and mm of the emulated arm."""
PORT_LIMIT = between(0, 65535, "a whole number")


@dataclass(frozen=True, kw_only=True)
class GalilOptions(Checked):
    """Options of `emulate galil` alone.

    Parameters
    ----------
    port : int
        Where galil listens on 127.0.0.1, by TCP and UDP; 0 takes one that is free.
    serial : bool
        Of galil: offer a serial port too, a pseudo-terminal whose path is told.
    mjpeg : int or None
        Of galil: offer the arm's camera too, as Motion JPEG on this port of 127.0.0.1; 0 takes one
        that is free.
    gige : bool
        Of galil: offer it as a GigE Vision camera at 127.0.0.1 (apt-get install libaravis-0.8-0).
    fault : tyro.conf.UseAppendAction[tuple[str, ...]]
        Of galil: what goes wrong, as kind:at=5,for=0.5; may be given several times. --fault help
        lists the kinds.
    """

    port: Annotated[int, PORT_LIMIT] = 2323
    serial: bool = False
    mjpeg: Annotated[int | None, PORT_LIMIT] = None
    gige: bool = False
    fault: tyro.conf.UseAppendAction[tuple[str, ...]] = ()


@dataclass(frozen=True)
class EmulateOptions(RosOptions, GalilOptions):
    """A motion controller on 127.0.0.1, or an arm on ROS topics, that drives a simulated arm, for
    developing without the hardware. It runs until Ctrl-C. Nothing real moves.

    Parameters
    ----------
    device : Literal['galil', 'crtk']
        The controller: galil (a DMC-4040 with four axes, the joints on A, B and C), or crtk (an arm
        on ROS topics, with its camera's pictures).
    seed : int
        Draws where the arm and its camera stand.
    rig : Path or None
        TOML file with your own mechanism, drives and scene.
    """

    device: Annotated[Literal["galil", "crtk"], tyro.conf.Positional]
    seed: Annotated[int, not_negative("whole number")] = 0
    rig: Path | None = None


def emulate(options: EmulateOptions) -> int:
    """Be the controller until Ctrl-C; the exit code is 0."""
    if "help" in options.fault:
        for name, words in FAULT_KINDS.items():
            print(f"{name:9} {words}")
        return 0
    _require_device_options(options)
    lab = load_lab(options.rig)
    if options.device == "crtk":
        return emulate_crtk(options, options.seed, lab)
    faults = [Fault.parse(text) for text in options.fault]
    with needing("emulate", "sim"):
        arm = EmulatedArm(options.seed, lab)
    with arm:
        cameras: list[str] = []
        if options.mjpeg is not None:
            cameras.append(arm.start_camera(send_mjpeg, options.mjpeg))
        if options.gige:
            cameras.append("GigE Vision " + arm.start_camera(send_gige))
        controller = Controller(arm.motors(COUNTS, AXES), AXES)
        serial = SerialPort() if options.serial else None
        with closing(Server(controller, options.port, faults, serial)) as server:
            at = f"127.0.0.1:{server.port}" + (f" and {serial.path}" if serial else "")
            seen = f", its camera at {' and '.join(cameras)}" if cameras else ""
            words = f"emulated Galil DMC-40{AXES}0 at {at}, simulated arm{seen}"
            out = console(False)
            out.print(f"{words}, seed {options.seed}; Ctrl-C ends it", soft_wrap=True)
            out.print(arm.measurements, soft_wrap=True)
            _serve_controller(server)
    return 0


def _require_device_options(options: EmulateOptions) -> None:
    """Refuse what is another controller's, which would be ignored."""
    for one in fields(GalilOptions if options.device == "crtk" else RosOptions):
        value = getattr(options, one.name)
        right = f"left out: emulate {options.device} has no such thing"
        require(value == one.default, f"--{one.name}", value, right)


def _serve_controller(server: Server) -> None:
    """As punctually as the system allows: a controller waits for no other program."""
    start = time.monotonic()
    with realtime(), contextlib.suppress(KeyboardInterrupt):
        while True:
            seconds = time.monotonic() - start
            server.turn(seconds)
            server.wait(SAMPLE_TIME_S - (time.monotonic() - start) % SAMPLE_TIME_S)
