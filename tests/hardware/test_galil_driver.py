"""Driver in wall time, over TCP and a serial port, with the emulated controller in a process.

test_galil_session.py tests the session in simulated time, and tests/live/test_live_rig.py the
emulator in a separate process.
"""

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest
from galil_measures import IdealMotors

from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.hardware.galil.connection import ConnectionLost, GalilConnection, SerialStream
from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, GalilController
from rcmservo.hardware.galil.emulator.faults import Fault
from rcmservo.hardware.galil.emulator.serial_port import SerialPort
from rcmservo.hardware.galil.emulator.server import GalilServer
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.live.device_protocols import NotReady
from rcmservo.live.realtime import request_urgent_priority
from rcmservo.loop.clock import WallClock
from stalls import retry_after_stalls

pytestmark = pytest.mark.alone

HOME = np.array([0.1, -0.2, 100.0])
RATES = np.array([0.1, -0.1, 10.0])
COUNTS = 50000.0, 50000.0, 500.0
TICK, PATIENCE = 10_000_000, 50_000_000


class WallTimeEmulator:
    """Emulated controller with ideal motors in wall time, in a process, unless it is `frozen`."""

    def __init__(self, *faults: str) -> None:
        self.serial = SerialPort()
        parsed = [Fault.parse(text) for text in faults]
        server = GalilServer(GalilController(IdealMotors()), 0, parsed, self.serial)
        self._port = server.port
        processes = multiprocessing.get_context("fork")
        self._process = processes.Process(target=emulate, args=(server,), daemon=True)
        self._process.start()
        server.close()  # the sockets of this process; the emulator has its own

    @contextlib.contextmanager
    def frozen(self) -> Iterator[None]:
        """Freeze the emulator."""
        assert self._process.pid is not None
        os.kill(self._process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self._process.pid, signal.SIGCONT)

    def arm(self, serial: bool, baud: int = 115200) -> GalilArm:
        """Connect the driver."""
        address = self.serial.path if serial else "127.0.0.1"
        settings = GalilSettings(address, COUNTS, self._port, baud, command_timeout=0.05)
        return GalilArm(settings, SphericalRcm().limits)

    def close(self) -> None:
        self._process.kill()
        self._process.join()


def emulate(server: GalilServer) -> None:
    """Advance an emulated controller with the time until the process ends."""
    start = time.monotonic()
    request_urgent_priority()
    while True:
        server.update(time.monotonic() - start)
        server.wait(SAMPLE_TIME_S)


@pytest.fixture(params=[False, True], ids=["by network", "by a serial port"])
def serial(request: pytest.FixtureRequest) -> bool:
    return request.param


@pytest.fixture
def emulator() -> Iterator[WallTimeEmulator]:
    with contextlib.closing(WallTimeEmulator()) as emulator:
        yield emulator


def drive(arm: GalilArm, rates: Floats, ticks: int) -> ArmMeasurement:
    """Send commands every 10 ms, as the loop does; return the measurement after the last."""
    clock = WallClock()
    start = clock.now()
    for number in range(ticks):
        now = start + number * TICK
        clock.wait_until(now)
        arm.apply(Command(number, now, now + PATIENCE, rates, True))
    clock.wait_until(start + ticks * TICK)
    return arm.measure()


def test_the_driver_moves_an_arm_whose_position_is_set_and_leaves_it_off(
    emulator: WallTimeEmulator, serial: bool
) -> None:
    with contextlib.closing(emulator.arm(serial)) as arm:
        assert not arm.measure().enabled
        assert not arm.is_homed()
        with pytest.raises(NotReady, match="the arm's position is not set"):
            arm.enable()
        arm.set_position(HOME)
        assert arm.measure().q == pytest.approx(HOME, abs=2e-3)

        def move() -> tuple[ArmMeasurement, ArmMeasurement]:
            arm.enable()
            return drive(arm, RATES, 10), drive(arm, RATES, 30)

        first, last = retry_after_stalls(move, lambda run: run[1].enabled)
        assert last.enabled, arm.off_reason
        rates = (last.q - first.q) / ((last.time - first.time) * 1e-9)
        assert rates == pytest.approx(RATES, rel=0.1)
        assert WallClock().now() - last.time < 50_000_000
    with contextlib.closing(emulator.arm(serial)) as arm:
        assert arm.is_homed() and not arm.measure().enabled


def test_a_disabled_command_switches_the_motors_off(emulator: WallTimeEmulator) -> None:
    with contextlib.closing(emulator.arm(serial=False)) as arm:
        arm.set_position(HOME)
        arm.enable()
        drive(arm, RATES, 10)
        clock = WallClock()
        arm.apply(Command(10, clock.now(), clock.now() + PATIENCE, np.zeros(3), False))
        end = clock.now() + 2_000_000_000
        while arm.measure().enabled and clock.now() < end:
            clock.wait_until(clock.now() + TICK)
        assert not arm.measure().enabled and not arm.off_reason
        assert arm.apply(Command(11, 0, 0, RATES, True)).tolist() == [0.0, 0.0, 0.0]


def test_the_age_of_the_measurement_shows_a_frozen_controller(
    emulator: WallTimeEmulator, serial: bool
) -> None:
    """A controller that continues switches the motors off by itself."""
    with contextlib.closing(emulator.arm(serial)) as arm:
        arm.set_position(HOME)
        arm.enable()
        drive(arm, RATES, 10)
        with emulator.frozen():
            measured = drive(arm, RATES, 40)
            assert WallClock().now() - measured.time > 300_000_000
        with pytest.raises(NotReady, match="has not answered"):
            arm.enable()
    with contextlib.closing(emulator.arm(serial)) as arm:
        assert not arm.measure().enabled


def test_an_unreachable_controller_is_reported() -> None:
    with pytest.raises(ConnectionLost, match=r"127\.0\.0\.1:1 cannot be reached"):
        GalilArm(GalilSettings("127.0.0.1", (1e5, 1e5, 1e3), 1), SphericalRcm().limits)


def test_a_serial_port_discards_replies_to_an_earlier_client() -> None:
    """The replies are so late that a pause would not separate them."""
    with contextlib.closing(WallTimeEmulator("slow:at=0")) as emulator:
        other = os.open(emulator.serial.path, os.O_RDWR | os.O_NOCTTY)
        os.write(other, b"MG 111\rMG 222;TP;ST;JG 50")
        stream = SerialStream(emulator.serial.path, 115200, 1.0)
        with contextlib.closing(GalilConnection(stream, 1.0)) as connection:
            assert connection.read_numbers("MG 333") == [333.0]
            assert connection.read_numbers("MG 444") == [444.0]
        os.close(other)


def test_a_serial_port_without_a_controller_is_reported_in_a_sentence() -> None:
    port = SerialPort()
    with pytest.raises(ConnectionLost, match=r"no Galil controller answers there"):
        SerialStream(port.path, 115200, 0.25)
    port.close()


def test_an_arm_on_a_slow_serial_port_can_be_set_up_but_not_enabled(
    emulator: WallTimeEmulator,
) -> None:
    with contextlib.closing(emulator.arm(serial=True, baud=19200)) as arm:
        arm.set_position(HOME)
        assert arm.is_homed()
        with pytest.raises(NotReady, match="at 19200 bits/s a command takes longer"):
            arm.enable()
