"""Start of a session: conditions that prevent it, and hosts that are lost meanwhile.

All in simulated time.
"""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from galil_measures import HOME, RATES, SETTINGS, EmulatedStream

from hardware.test_galil_session import Rig
from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.galil import watchdog_program as program
from rcmservo.hardware.galil.connection import CommandRejected, ConnectionLost
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, GalilController
from rcmservo.live.device_protocols import NotReady


class CutStream(EmulatedStream):
    """Stream that transmits only a number of lines after the last `cut`."""

    def __init__(self, controller: GalilController) -> None:
        super().__init__(controller)
        self.lines: list[bytes] = []
        self.max_lines = 10_000

    def cut(self, max_lines: int) -> None:
        self.lines, self.max_lines = [], max_lines

    def send(self, data: bytes) -> None:
        self.deaf = len(self.lines) >= self.max_lines
        super().send(data)
        self.lines.append(data)


def cut_off_after(lines: int) -> Rig:
    """Return a rig whose host was cut off during its start, after a number of lines.

    If the start succeeded, the rig is returned at once, otherwise 0.2 s later and at rest.
    """
    rig = Rig(stream_type=CutStream)
    rig.session.set_position(HOME)
    cut_stream(rig).cut(lines)
    with contextlib.suppress(ConnectionLost):
        rig.session.start()
        return rig
    rig.wait(0.2)
    assert rig.at_rest
    return rig


def cut_stream(rig: Rig) -> CutStream:
    stream = rig.streams[0]
    assert isinstance(stream, CutStream)
    return stream


def run_before_program_start(rig: Rig, action: Callable[[], Any]) -> None:
    """Run an action just before the driver starts the watchdog program."""
    stream, send = rig.streams[0], rig.streams[0].send

    def send_after_action(data: bytes) -> None:
        if data.startswith(b"XQ #RCMWD"):
            action()
        send(data)

    stream.send = send_after_action  # type: ignore[method-assign]


def test_a_start_replaces_the_settings_and_program_of_others() -> None:
    """Another host has connected meanwhile, with changed settings."""
    rig = Rig()
    rig.session.set_position(HOME)
    query = "MG _ACA,_DCB,_SDC,_ERA,_OEB,_FLC,_BLC"
    before, lines = rig.connect().read_numbers(query), rig.controller.state.program.lines
    edited = replace(
        SETTINGS,
        acceleration=(1.0, 1.0, 100.0),
        deceleration=(1.0, 1.0, 100.0),
        following_error=(0.5, 0.5, 50.0),
        command_timeout=0.05,
    )
    limits = JointLimits((-2.0, -2.0, -10.0), (2.0, 2.0, 300.0))
    rig.new_session(edited, limits).set_position(HOME)
    rig.connect().execute("OEB=0")
    assert rig.controller.state.program.lines != lines
    rig.session.start()
    assert rig.connect().read_numbers(query) == before
    assert rig.controller.state.program.lines == lines
    assert rig.controller.state.message_destination == "B"
    assert rig.jog(RATES, 0.1).all_on


@pytest.mark.parametrize(
    ("lines", "message"),
    [(["#OTHER", "EN"], "refused 'XQ #RCMWD,1'"), (["#RCMWD", "EN"], "the axes do not begin")],
)
def test_a_program_that_replaces_the_watchdog_at_the_start_moves_nothing(
    lines: list[str], message: str
) -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    run_before_program_start(rig, lambda: rig.connect().download_program(lines))
    with pytest.raises((CommandRejected, NotReady), match=message):
        rig.session.start()
    assert rig.motors_off and rig.at_rest


def test_a_failed_start_reports_its_own_reason_and_not_an_earlier_stop() -> None:
    rig = Rig().start()
    rig.jog(np.array([0.0, 0.0, -40.0]), 2.7)
    assert "axis C was stopped by its reverse limit" in rig.session.off_reason
    other = rig.connect()
    other.execute("DPC=0")
    run_before_program_start(rig, lambda: other.execute("JG 500", "FLA=-2000000"))
    with pytest.raises(NotReady) as refused:
        rig.session.start()
    assert "do not begin: Begin not possible due to Limit Switch" in str(refused.value)
    assert "reverse limit" not in str(refused.value)
    assert rig.motors_off and rig.at_rest


def test_a_failed_start_does_not_report_an_earlier_command_error() -> None:
    rig = Rig().start()
    rig.session.switch_off()
    rig.controller.state.error = 1
    run_before_program_start(rig, lambda: setattr(rig.controller, "unpowered", True))
    with pytest.raises(NotReady) as refused:
        rig.session.start()
    assert "do not begin: axis A was switched off by a fault of its amp" in str(refused.value)
    assert rig.motors_off and rig.at_rest


def test_a_start_that_is_cut_off_at_any_line_leaves_the_motors_off() -> None:
    complete_start = cut_off_after(1000)
    assert not complete_start.motors_off
    line_count = len(cut_stream(complete_start).lines)
    assert line_count > 10
    for sent_lines in range(line_count):
        assert cut_off_after(sent_lines).motors_off, sent_lines


def test_a_delayed_line_that_arrives_after_the_host_is_gone_leaves_the_motors_off() -> None:
    """A reconnected cable retransmits lines that were sent before."""
    for sent_lines in range(len(cut_stream(cut_off_after(1000)).lines)):
        rig = cut_off_after(sent_lines)
        late_handle = rig.controller.connect()
        assert late_handle is not None
        rig.controller.receive(late_handle, cut_stream(rig).lines[sent_lines])
        rig.wait(0.2)
        assert rig.motors_off and rig.at_rest, sent_lines


def test_only_the_line_that_starts_the_program_switches_motors_on() -> None:
    """A delayed line of its own could switch them on after the program has ended."""
    rig = Rig(stream_type=CutStream)
    assert not any(b"SH" in line for line in cut_stream(rig).lines)
    rig.start()
    lines_with_sh = [line for line in cut_stream(rig).lines if b"SH" in line]
    assert lines_with_sh == [b"XQ #RCMWD,1;SH ABC\r"]


def test_no_line_is_sent_after_a_refused_line_of_a_program() -> None:
    """The emulator executes such lines as commands, as a controller may."""
    rig = Rig()
    with pytest.raises(CommandRejected, match="refused '#A': 61 Duplicate or bad label"):
        rig.connect().download_program(["#A", "#A", "JG 500"])
    assert rig.controller.state.axes[0].settings.JG != 500.0
    assert rig.session.read().q[0] == 0.0


def start_other_program(rig: Rig, thread: int = 3) -> None:
    """Run a program of another host in a thread."""
    other = rig.connect()
    other.download_program(["#OTHER", "WT 2", "JP #OTHER"])
    other.execute(f"XQ #OTHER,{thread}")


@pytest.mark.parametrize("thread", [0, 3, 7])
def test_a_controller_that_runs_another_program_is_refused(thread: int) -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    start_other_program(rig, thread)
    message = f"a program runs on the controller, in thread {thread}"
    with pytest.raises(NotReady, match=message):
        rig.new_session()
    with pytest.raises(NotReady, match=message):
        rig.session.start()
    assert rig.motors_off and rig.at_rest


@pytest.mark.parametrize("microseconds", [500, 2000])
def test_a_controller_with_another_sample_time_is_refused(
    microseconds: int,
) -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    other = rig.connect()
    other.execute(f"TM {microseconds}")
    assert other.read_numbers("TM ?") == [microseconds] and other.read_number("_TM") == microseconds
    message = f"TM is {microseconds} on the controller: set it to 1000"
    with pytest.raises(NotReady, match=message):
        rig.new_session()
    with pytest.raises(NotReady, match=message):
        rig.session.start()
    assert rig.motors_off
    other.execute("TM 1000")
    rig.session.start()


@pytest.mark.parametrize("microseconds", [0, 124, 20001, -1000])
def test_a_sample_time_outside_the_range_of_four_axes_is_refused(microseconds: int) -> None:
    """DMC-40x0 command reference, TM; the emulator cannot stop its samples."""
    with pytest.raises(CommandRejected, match="6 Number out of range"):
        Rig().connect().execute(f"TM {microseconds}")


class LateStream(EmulatedStream):
    """Stream with replies that arrive `delay` s late."""

    delay = 0.0

    def __init__(self, controller: GalilController) -> None:
        super().__init__(controller)
        self.in_transit: list[tuple[float, bytes]] = []

    def receive(self, seconds: float) -> bytes:
        end = self.controller.state.samples * SAMPLE_TIME_S + seconds
        while self.handle in self.controller.connections:
            now = self.controller.state.samples * SAMPLE_TIME_S
            self.in_transit.append((now + self.delay, self.controller.take_output(self.handle)))
            arrived = b"".join(data for due, data in self.in_transit if due <= now)
            self.in_transit = [(due, data) for due, data in self.in_transit if due > now]
            if arrived or now >= end:
                return arrived
            self.controller.sample()
        raise ConnectionResetError("gone")


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.09])
def test_no_line_is_sent_after_a_refused_DL(delay: float) -> None:
    """The emulator would execute the lines as commands, as a controller may."""
    rig = Rig(stream_type=LateStream)
    start_other_program(rig)
    rig.connect().execute("SH ABC", "JG 500,500,500")
    connection = rig.connect()
    stream = rig.streams[-1]
    assert isinstance(stream, LateStream)
    stream.delay = delay
    with pytest.raises(CommandRejected, match="refused 'DL': 17 ED, BN and DL not valid"):
        connection.download_program(program.program_lines("ABC", 40))
    assert connection.read_number("1") == 1.0
    assert rig.at_rest


@pytest.mark.parametrize("delay", [0.11, 0.15, 0.24])
def test_lines_that_the_controller_executes_as_commands_move_nothing(delay: float) -> None:
    """The controller refuses the download too late, because another program has just started."""
    rig = Rig(stream_type=LateStream)
    rig.session.set_position(HOME)
    rig.connect().execute("JG 500,500,500")
    other, stream = rig.connect(), rig.streams[0]
    assert isinstance(stream, LateStream)
    stream.delay, send, armed = delay, stream.send, list[bool]()

    def send_after_program_start(data: bytes) -> None:
        if data == b"DL\r":
            start_other_program(rig)
            armed.append(True)
        send(data)
        assert rig.motors_off or not armed

    stream.send = send_after_program_start  # type: ignore[method-assign]
    with pytest.raises(CommandRejected, match=r"refused '(DL|#RCM|WT)"):
        rig.session.set_up()
    rig.wait(0.2)
    assert rig.motors_off and rig.at_rest
    assert other.read_numbers("MG _JGA,_JGB,_JGC") == [0.0] * 3


def test_the_last_line_of_a_start_restarts_the_timeout() -> None:
    """The host is slow before that line and after it, in total for longer than the timeout."""
    rig = Rig()
    rig.session.set_position(HOME)
    stream, send = rig.streams[0], rig.streams[0].send
    delay = 0.7 * SETTINGS.command_timeout

    def send_late(data: bytes) -> None:
        if data.endswith(b"QR\r"):
            rig.wait(delay)
        send(data)

    stream.send = send_late  # type: ignore[method-assign]
    assert rig.session.start().all_on
    rig.wait(delay)
    assert not rig.motors_off
