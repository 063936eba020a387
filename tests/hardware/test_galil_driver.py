"""The driver as the loop meets it, in wall time, over TCP and a serial port, with the emulated
controller in a thread. Its talk is tested in simulated time in test_galil_session.py, and the
emulator in a process of its own in tests/live/test_live_rig.py."""

import contextlib
import os
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from galil_measures import IdealMotors

from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.emulator.controller import SAMPLE, Controller
from rcmservo.hardware.galil.emulator.faults import Fault
from rcmservo.hardware.galil.emulator.serial_port import SerialPort
from rcmservo.hardware.galil.emulator.server import Server
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.wire import Conversation, Lost, SerialStream
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.live.lab import NotReady
from rcmservo.live.realtime import urgent
from rcmservo.loop.clock import WallClock
from rcmservo.method.kinematics import SphericalRcm
from stalls import undisturbed

pytestmark = pytest.mark.alone

HOME = np.array([0.1, -0.2, 100.0])
RATES = np.array([0.1, -0.1, 10.0])
COUNTS = 50000.0, 50000.0, 500.0
TICK, PATIENCE = 10_000_000, 50_000_000


class Emulated:
    """A controller with ideal motors that lives in wall time, in a thread, unless it is `held`."""

    def __init__(self, *faults: str) -> None:
        self.serial = SerialPort()
        told = [Fault.parse(one) for one in faults]
        self._server = Server(Controller(IdealMotors()), 0, told, self.serial)
        self._over, self._free = threading.Event(), threading.Event()
        self._free.set()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def _live(self) -> None:
        start = time.monotonic()
        urgent()
        while not self._over.is_set():
            self._free.wait()
            self._server.turn(time.monotonic() - start)
            self._server.wait(SAMPLE)

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """In here it stands still."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def arm(self, serial: bool, baud: int = 115200) -> GalilArm:
        """The driver of the arm behind it."""
        address = self.serial.path if serial else "127.0.0.1"
        settings = GalilSettings(address, COUNTS, self._server.port, baud)
        return GalilArm(settings, SphericalRcm().limits)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._server.close()


@pytest.fixture(params=[False, True], ids=["by network", "by a serial port"])
def serial(request: pytest.FixtureRequest) -> bool:
    return request.param


@pytest.fixture
def emulated() -> Iterator[Emulated]:
    with contextlib.closing(Emulated()) as one:
        yield one


def sent(arm: GalilArm, rates: Floats, ticks: int) -> Measured:
    """Commands every 10 ms, as the loop sends them; how the arm is after the last."""
    clock = WallClock()
    start = clock.now()
    for number in range(ticks):
        now = start + number * TICK
        clock.wait_until(now)
        arm.apply(Command(number, now, now + PATIENCE, rates, True))
    clock.wait_until(start + ticks * TICK)
    return arm.measure()


def test_it_moves_an_arm_whose_place_a_person_has_told_and_leaves_it_off(
    emulated: Emulated, serial: bool
) -> None:
    with contextlib.closing(emulated.arm(serial)) as arm:
        assert not arm.measure().enabled
        assert not arm.homed()
        with pytest.raises(NotReady, match="nobody has said where the arm stands"):
            arm.enable()
        arm.define(HOME)
        assert arm.measure().q == pytest.approx(HOME, abs=2e-3)

        def moved() -> tuple[Measured, Measured]:
            arm.enable()
            return sent(arm, RATES, 10), sent(arm, RATES, 30)

        first, last = undisturbed(moved, lambda run: run[1].enabled)
        assert last.enabled, arm.why_off
        rates = (last.q - first.q) / ((last.time - first.time) * 1e-9)
        assert rates == pytest.approx(RATES, rel=0.1)
        assert WallClock().now() - last.time < 50_000_000
    with contextlib.closing(emulated.arm(serial)) as arm:
        assert arm.homed() and not arm.measure().enabled


def test_a_command_that_is_not_enabled_switches_the_motors_off(emulated: Emulated) -> None:
    with contextlib.closing(emulated.arm(serial=False)) as arm:
        arm.define(HOME)
        arm.enable()
        sent(arm, RATES, 10)
        clock = WallClock()
        arm.apply(Command(10, clock.now(), clock.now() + PATIENCE, np.zeros(3), False))
        end = clock.now() + 2_000_000_000
        while arm.measure().enabled and clock.now() < end:
            clock.wait_until(clock.now() + TICK)
        assert not arm.measure().enabled and not arm.why_off
        assert arm.apply(Command(11, 0, 0, RATES, True)).tolist() == [0.0, 0.0, 0.0]


def test_a_controller_that_stands_still_is_told_by_the_age_of_its_answer(
    emulated: Emulated, serial: bool
) -> None:
    """And it is off when it goes on, though nobody tells it to."""
    with contextlib.closing(emulated.arm(serial)) as arm:
        arm.define(HOME)
        arm.enable()
        sent(arm, RATES, 10)
        with emulated.held():
            told = sent(arm, RATES, 40)
            assert WallClock().now() - told.time > 300_000_000
        with pytest.raises(NotReady, match="has not answered"):
            arm.enable()
    with contextlib.closing(emulated.arm(serial)) as arm:
        assert not arm.measure().enabled


def test_where_there_is_no_controller_it_says_so() -> None:
    with pytest.raises(Lost, match=r"127\.0\.0\.1:1 cannot be reached"):
        GalilArm(GalilSettings("127.0.0.1", (1e5, 1e5, 1e3), 1), SphericalRcm().limits)


def test_a_serial_port_begins_anew_behind_what_somebody_else_asked_and_left() -> None:
    """Answers that come later than a moment of silence would wait for."""
    with contextlib.closing(Emulated("slow:at=0")) as emulated:
        other = os.open(emulated.serial.path, os.O_RDWR | os.O_NOCTTY)
        os.write(other, b"MG 111\rMG 222;TP;ST;JG 50")
        stream = SerialStream(emulated.serial.path, 115200, 1.0)
        with contextlib.closing(Conversation(stream, 1.0)) as talk:
            assert talk.numbers("MG 333") == [333.0]
            assert talk.numbers("MG 444") == [444.0]
        os.close(other)


def test_a_serial_port_behind_which_nothing_answers_is_told_in_a_sentence() -> None:
    port = SerialPort()
    with pytest.raises(Lost, match=r"no Galil controller answers there"):
        SerialStream(port.path, 115200, 0.25)
    port.close()


def test_by_a_slow_serial_port_an_arm_is_set_up_but_not_enabled(emulated: Emulated) -> None:
    with contextlib.closing(emulated.arm(serial=True, baud=19200)) as arm:
        arm.define(HOME)
        assert arm.homed()
        with pytest.raises(NotReady, match="at 19200 bits/s a command takes longer"):
            arm.enable()
