"""How the driver enables an arm: what stands in the way, and what a host leaves that is lost
meanwhile. In simulated time."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from galil_measures import HOME, RATES, SETTINGS, EmulatedWire

from hardware.test_galil_session import Rig
from rcmservo.hardware.galil import watchdog_program as program
from rcmservo.hardware.galil.emulator.controller import SAMPLE, Controller
from rcmservo.hardware.galil.wire import Lost, Rejected
from rcmservo.live.lab import NotReady
from rcmservo.method.kinematics import JointLimits


class CutWire(EmulatedWire):
    """One by which only so many lines are heard, from the last `cut` on."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self.lines: list[bytes] = []
        self.left = 10_000

    def cut(self, left: int) -> None:
        self.lines, self.left = [], left

    def send(self, data: bytes) -> None:
        self.deaf = len(self.lines) >= self.left
        super().send(data)
        self.lines.append(data)


def cut_off_after(lines: int) -> Rig:
    """A rig a while after it was enabled by a host that nothing was heard of after so many lines,
    but where it came to the end."""
    rig = Rig(wire=CutWire)
    rig.session.define(HOME)
    cut_of(rig).cut(lines)
    with contextlib.suppress(Lost):
        rig.session.start()
        return rig
    rig.wait(0.2)
    assert rig.still
    return rig


def cut_of(rig: Rig) -> CutWire:
    wire = rig.wires[0]
    assert isinstance(wire, CutWire)
    return wire


def just_before_the_program_starts(rig: Rig, happen: Callable[[], Any]) -> None:
    """Let something happen in that moment."""
    wire, send = rig.wires[0], rig.wires[0].send

    def beaten(data: bytes) -> None:
        if data.startswith(b"XQ #RCMWD"):
            happen()
        send(data)

    wire.send = beaten  # type: ignore[method-assign]


def test_enabling_puts_its_own_settings_and_program_in_the_place_of_others() -> None:
    """Somebody has connected meanwhile, with a file in which these were edited."""
    rig = Rig()
    rig.session.define(HOME)
    asked = "MG _ACA,_DCB,_SDC,_ERA,_OEB,_FLC,_BLC"
    before, lines = rig.talk().numbers(asked), rig.controller.state.program.lines
    edited = replace(
        SETTINGS,
        acceleration=(1.0, 1.0, 100.0),
        deceleration=(1.0, 1.0, 100.0),
        following_error=(0.5, 0.5, 50.0),
        patience=0.05,
    )
    limits = JointLimits((-2.0, -2.0, -10.0), (2.0, 2.0, 300.0))
    rig.connected(edited, limits).define(HOME)
    rig.talk().ask("OEB=0")
    assert rig.controller.state.program.lines != lines
    rig.session.start()
    assert rig.talk().numbers(asked) == before
    assert rig.controller.state.program.lines == lines
    assert rig.controller.state.messages_to == "B"
    assert rig.jog(RATES, 0.1).on


@pytest.mark.parametrize(
    ("lines", "said"),
    [(["#OTHER", "EN"], "refused 'XQ #RCMWD,1'"), (["#RCMWD", "EN"], "the axes do not begin")],
)
def test_a_program_that_somebody_puts_in_its_place_at_that_moment_begins_nothing(
    lines: list[str], said: str
) -> None:
    rig = Rig()
    rig.session.define(HOME)
    just_before_the_program_starts(rig, lambda: rig.talk().download(lines))
    with pytest.raises((Rejected, NotReady), match=said):
        rig.session.start()
    assert rig.off and rig.still


def test_a_beginning_that_is_refused_is_told_by_its_own_reason_and_not_by_an_earlier_stop() -> None:
    rig = Rig().started()
    rig.jog(np.array([0.0, 0.0, -40.0]), 2.7)
    assert "axis C was stopped by its reverse limit" in rig.session.why_off
    other = rig.talk()
    other.ask("DPC=0")
    just_before_the_program_starts(rig, lambda: other.ask("JG 500", "FLA=-2000000"))
    with pytest.raises(NotReady) as refused:
        rig.session.start()
    assert "do not begin: Begin not possible due to Limit Switch" in str(refused.value)
    assert "reverse limit" not in str(refused.value)
    assert rig.off and rig.still


def test_a_beginning_that_fails_is_not_told_by_what_was_refused_to_somebody_before() -> None:
    rig = Rig().started()
    rig.session.switch_off()
    rig.controller.state.error = 1
    just_before_the_program_starts(rig, lambda: setattr(rig.controller, "unpowered", True))
    with pytest.raises(NotReady) as refused:
        rig.session.start()
    assert "do not begin: axis A was switched off by a fault of its amp" in str(refused.value)
    assert rig.off and rig.still


def test_an_enabling_that_is_cut_off_at_whatever_line_leaves_the_motors_off() -> None:
    whole = cut_off_after(1000)
    assert not whole.off
    lines = len(cut_of(whole).lines)
    assert lines > 10
    for after in range(lines):
        assert cut_off_after(after).off, after


def test_a_line_that_is_held_up_and_arrives_when_the_host_is_gone_leaves_the_motors_off() -> None:
    """As when the cable is plugged in again: what was sent before is sent again."""
    for before in range(len(cut_of(cut_off_after(1000)).lines)):
        rig = cut_off_after(before)
        late = rig.controller.connect()
        assert late is not None
        rig.controller.hear(late, cut_of(rig).lines[before])
        rig.wait(0.2)
        assert rig.off and rig.still, before


def test_motors_are_switched_on_by_one_line_behind_the_start_of_the_program_alone() -> None:
    """Or a line that is held up on its way would switch them on when the program has ended."""
    rig = Rig(wire=CutWire)
    assert not any(b"SH" in line for line in cut_of(rig).lines)
    rig.started()
    on = [line for line in cut_of(rig).lines if b"SH" in line]
    assert on == [b"XQ #RCMWD,1;SH ABC\r"]


def test_what_follows_a_refused_line_of_a_program_is_not_sent() -> None:
    """The emulator takes it for commands, as a controller may."""
    rig = Rig()
    with pytest.raises(Rejected, match="refused '#A': 61 Duplicate or bad label"):
        rig.talk().download(["#A", "#A", "JG 500"])
    assert rig.controller.state.axes[0].settings.JG != 500.0
    assert rig.session.look().q[0] == 0.0


def occupied(rig: Rig, thread: int = 3) -> None:
    """Somebody's program runs in another thread."""
    other = rig.talk()
    other.download(["#OTHER", "WT 2", "JP #OTHER"])
    other.ask(f"XQ #OTHER,{thread}")


@pytest.mark.parametrize("thread", [0, 3, 7])
def test_a_controller_on_which_somebodys_program_runs_is_left_alone(thread: int) -> None:
    rig = Rig()
    rig.session.define(HOME)
    occupied(rig, thread)
    said = f"a program runs on the controller, in thread {thread}"
    with pytest.raises(NotReady, match=said):
        rig.connected()
    with pytest.raises(NotReady, match=said):
        rig.session.start()
    assert rig.off and rig.still


@pytest.mark.parametrize("microseconds", [500, 2000])
def test_a_controller_with_other_samples_is_refused_as_its_patience_would_be_another(
    microseconds: int,
) -> None:
    rig = Rig()
    rig.session.define(HOME)
    other = rig.talk()
    other.ask(f"TM {microseconds}")
    assert other.numbers("TM ?") == [microseconds] and other.number("_TM") == microseconds
    said = f"TM is {microseconds} on the controller: set it to 1000"
    with pytest.raises(NotReady, match=said):
        rig.connected()
    with pytest.raises(NotReady, match=said):
        rig.session.start()
    assert rig.off
    other.ask("TM 1000")
    rig.session.start()


@pytest.mark.parametrize("wrong", [0, 124, 20001, -1000])
def test_samples_that_a_controller_of_four_axes_cannot_have_are_refused(wrong: int) -> None:
    """DMC-40x0 command reference, TM; the emulator does not switch its samples off."""
    with pytest.raises(Rejected, match="6 Number out of range"):
        Rig().talk().ask(f"TM {wrong}")


class LateWire(EmulatedWire):
    """One on which answers come `late` s later."""

    late = 0.0

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self.under_way: list[tuple[float, bytes]] = []

    def receive(self, seconds: float) -> bytes:
        end = self.controller.state.samples * SAMPLE + seconds
        while self.handle in self.controller.lines:
            now = self.controller.state.samples * SAMPLE
            self.under_way.append((now + self.late, self.controller.answers(self.handle)))
            told = b"".join(data for due, data in self.under_way if due <= now)
            self.under_way = [(due, data) for due, data in self.under_way if due > now]
            if told or now >= end:
                return told
            self.controller.sample()
        raise ConnectionResetError("gone")


@pytest.mark.parametrize("late", [0.0, 0.03, 0.09])
def test_of_a_program_that_is_refused_from_the_start_no_line_is_sent(late: float) -> None:
    """The emulator would take them for commands, as a controller may."""
    rig = Rig(wire=LateWire)
    occupied(rig)
    rig.talk().ask("SH ABC", "JG 500,500,500")
    talk = rig.talk()
    wire = rig.wires[-1]
    assert isinstance(wire, LateWire)
    wire.late = late
    with pytest.raises(Rejected, match="refused 'DL': 17 ED, BN and DL not valid"):
        talk.download(program.lines("ABC", 40))
    assert talk.number("1") == 1.0
    assert rig.still


@pytest.mark.parametrize("late", [0.11, 0.15, 0.24])
def test_lines_that_the_controller_takes_for_commands_move_nothing(late: float) -> None:
    """Where it says too late that it takes no program, as somebody has started one meanwhile."""
    rig = Rig(wire=LateWire)
    rig.session.define(HOME)
    rig.talk().ask("JG 500,500,500")
    other, wire = rig.talk(), rig.wires[0]
    assert isinstance(wire, LateWire)
    wire.late, send, armed = late, wire.send, list[bool]()

    def beaten(data: bytes) -> None:
        if data == b"DL\r":
            occupied(rig)
            armed.append(True)
        send(data)
        assert rig.off or not armed

    wire.send = beaten  # type: ignore[method-assign]
    with pytest.raises(Rejected, match=r"refused '(DL|#RCM|WT)"):
        rig.session.set_up()
    rig.wait(0.2)
    assert rig.off and rig.still
    assert other.numbers("MG _JGA,_JGB,_JGC") == [0.0] * 3
