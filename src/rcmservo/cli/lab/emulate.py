"""`rcmservo emulate`: an emulated motion controller or ROS arm that drives a simulated arm."""

import contextlib
import time
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from rcmservo.cli.lab.emulate_crtk import RosOptions, emulate_crtk
from rcmservo.cli.lab.emulated_arm import EmulatedArm, send_gige, send_mjpeg
from rcmservo.cli.terminal import open_console
from rcmservo.config.rig_file import load_rig_file
from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import require, require_extra
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, GalilController
from rcmservo.hardware.galil.emulator.faults import FAULT_KINDS, Fault
from rcmservo.hardware.galil.emulator.serial_port import SerialPort
from rcmservo.hardware.galil.emulator.server import GalilServer
from rcmservo.live.realtime import apply_realtime_settings

AXES = 4
"""Number of axes of the emulated controller, of which the last drives no joint."""
COUNTS_PER_UNIT = 50000.0, 50000.0, 500.0
"""Encoder counts of the emulated arm per rad, rad and mm."""
PORT_LIMIT = between(0, 65535, "a whole number")


@dataclass(frozen=True, kw_only=True)
class GalilOptions(Checked):
    """Options of `emulate galil` only.

    Parameters
    ----------
    port : int
        Port on 127.0.0.1 on which galil listens, by TCP and UDP; 0 takes a free one.
    serial : bool
        galil: also offer a serial port, a pseudo-terminal whose path is printed.
    mjpeg : int or None
        galil: also offer the arm's camera, as Motion JPEG on this port of 127.0.0.1; 0 takes a
        free one.
    gige : bool
        galil: also offer the camera as a GigE Vision camera at 127.0.0.1 (apt-get install
        libaravis-0.8-0).
    fault : tyro.conf.UseAppendAction[tuple[str, ...]]
        galil: fault to emulate, as kind:at=5,for=0.5; repeatable. --fault help lists the kinds.
    """

    port: Annotated[int, PORT_LIMIT] = 2323
    serial: bool = False
    mjpeg: Annotated[int | None, PORT_LIMIT] = None
    gige: bool = False
    fault: tyro.conf.UseAppendAction[tuple[str, ...]] = ()


@dataclass(frozen=True)
class EmulateOptions(RosOptions, GalilOptions):
    """Emulate a motion controller on 127.0.0.1, or an arm on ROS topics, with a simulated arm.

    It serves development without hardware and runs until Ctrl-C. No real arm moves.

    Parameters
    ----------
    device : Literal['galil', 'crtk']
        Emulated device: galil (a DMC-4040 with four axes, the joints on A, B and C), or crtk
        (an arm on ROS topics, with the images of its camera).
    seed : int
        Seed that draws the poses of the arm and its camera.
    rig : Path or None
        TOML file with your own mechanism, drives and scene.
    """

    device: Annotated[Literal["galil", "crtk"], tyro.conf.Positional]
    seed: Annotated[int, not_negative("whole number")] = 0
    rig: Path | None = None


def emulate(options: EmulateOptions) -> int:
    """Emulate the device until Ctrl-C and return the exit code 0."""
    if "help" in options.fault:
        for name, description in FAULT_KINDS.items():
            print(f"{name:9} {description}")
        return 0
    _require_device_options(options)
    lab = load_rig_file(options.rig)
    if options.device == "crtk":
        return emulate_crtk(options, options.seed, lab)
    faults = [Fault.parse(text) for text in options.fault]
    with require_extra("emulate", "sim"):
        arm = EmulatedArm(options.seed, lab)
    with arm:
        cameras: list[str] = []
        if options.mjpeg is not None:
            cameras.append(arm.start_camera(send_mjpeg, options.mjpeg))
        if options.gige:
            cameras.append("GigE Vision " + arm.start_camera(send_gige))
        controller = GalilController(arm.make_motors(COUNTS_PER_UNIT, AXES), AXES)
        serial = SerialPort() if options.serial else None
        with closing(GalilServer(controller, options.port, faults, serial)) as server:
            address = f"127.0.0.1:{server.port}" + (f" and {serial.path}" if serial else "")
            camera = f", its camera at {' and '.join(cameras)}" if cameras else ""
            device = f"emulated Galil DMC-40{AXES}0 at {address}, simulated arm{camera}"
            console = open_console()
            console.print(f"{device}, seed {options.seed}; Ctrl-C ends it", soft_wrap=True)
            console.print(arm.ruler_measurements, soft_wrap=True)
            _serve_controller(server)
    return 0


def _require_device_options(options: EmulateOptions) -> None:
    """Refuse options of the other device, which would have no effect."""
    for option in fields(GalilOptions if options.device == "crtk" else RosOptions):
        value = getattr(options, option.name)
        expected = f"left out, because emulate {options.device} has no such option"
        require(value == option.default, f"--{option.name}", value, expected)


def _serve_controller(server: GalilServer) -> None:
    """Serve at each sample time as punctually as the system allows, as a real controller does."""
    start_s = time.monotonic()
    with apply_realtime_settings(), contextlib.suppress(KeyboardInterrupt):
        while True:
            server.update(time.monotonic() - start_s)
            server.wait(SAMPLE_TIME_S - (time.monotonic() - start_s) % SAMPLE_TIME_S)
