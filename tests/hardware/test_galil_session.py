"""The driver's side of the talk with a controller, against the emulated one, in simulated time."""

from dataclasses import replace

import numpy as np
import pytest
from galil_measures import HOME, LIMITS, RATES, SETTINGS, EmulatedWire, IdealMotors

from rcmservo.hardware.galil.amplifier import errors
from rcmservo.hardware.galil.emulator.axis import StopCode
from rcmservo.hardware.galil.emulator.controller import SAMPLE, Controller
from rcmservo.hardware.galil.session import ArmReading, GalilSession
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.wire import Conversation, Lost
from rcmservo.interfaces import Floats
from rcmservo.live.lab import NotReady
from rcmservo.method.kinematics import JointLimits

TICK = 0.01


class Rig:
    """A session with an emulated controller, and whoever else talks with that."""

    def __init__(
        self, settings: GalilSettings = SETTINGS, wire: type[EmulatedWire] = EmulatedWire
    ) -> None:
        self.motors = IdealMotors()
        self.controller = Controller(self.motors)
        self.wire, self.wires = wire, list[EmulatedWire]()
        self.session = self.connected(settings)

    def connected(
        self, settings: GalilSettings = SETTINGS, limits: JointLimits = LIMITS
    ) -> GalilSession:
        talks = [self.talk(settings.answer_within) for _ in range(2)]
        session = GalilSession(*talks, settings, limits)
        session.set_up()
        return session

    def talk(self, within: float = 0.25) -> Conversation:
        self.wires.append(self.wire(self.controller))
        return Conversation(self.wires[-1], within, self.now)

    def now(self) -> float:
        return self.controller.state.samples * SAMPLE

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / SAMPLE)):
            self.controller.sample()

    def started(self) -> "Rig":
        self.session.define(HOME)
        self.session.start()
        return self

    def jog(self, rates: Floats, seconds: float) -> ArmReading:
        """Speeds every 10 ms, as the loop sends them."""
        told = self.session.exchange(rates)
        for _ in range(round(seconds / TICK)):
            self.wait(TICK)
            told = self.session.exchange(rates)
        return told

    @property
    def still(self) -> bool:
        return not any(axis.moving or axis.speed for axis in self.controller.state.axes)

    @property
    def off(self) -> bool:
        return all(axis.off for axis in self.controller.state.axes[:3])


def test_joints_go_at_their_rates_by_the_signs_and_units_of_the_settings() -> None:
    rig = Rig().started()
    begin, since = rig.jog(RATES, 0.3), rig.now()
    end = rig.jog(RATES, 0.5)
    assert (end.q - begin.q) / (rig.now() - since) == pytest.approx(RATES, rel=0.01)
    assert begin.on and end.on
    counts = rig.motors.counts
    assert counts[0] > 0 and counts[1] < 0 and counts[2] < 0


def test_where_a_person_says_it_stands_is_where_it_is() -> None:
    rig = Rig()
    rig.session.define(HOME)
    assert rig.session.look().q == pytest.approx(HOME, abs=1e-3)


def test_until_a_person_says_where_it_stands_nobody_enables_and_a_reset_forgets() -> None:
    rig = Rig()
    with pytest.raises(NotReady, match="nobody has said where the arm stands"):
        rig.session.start()
    rig.started()
    rig.controller.reset()
    with pytest.raises(Lost):
        rig.session.look()
    again = rig.connected()
    assert not again.homed()
    with pytest.raises(NotReady, match="nobody has said"):
        again.start()


def silent_for(rig: Rig, seconds: float) -> tuple[float, float]:
    """s until the axes stand, and until the motors are off, from now on."""
    begin, stood, off = rig.now(), np.inf, np.inf
    while rig.now() - begin < seconds:
        rig.wait(SAMPLE)
        stood = min(stood, rig.now() - begin) if rig.still else np.inf
        off = min(off, rig.now() - begin) if rig.off else np.inf
    return stood, off


def test_a_host_that_falls_silent_is_noticed_by_the_controller_alone() -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.5)
    stood, off = silent_for(rig, 0.5)
    fall = max(0.3 / 10.0, 20.0 / 1000.0)
    assert 0.03 < stood < SETTINGS.patience + fall + 0.01
    assert off < stood + 0.01


def test_what_comes_after_the_controller_stopped_moves_nothing_until_somebody_enables() -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.5)
    silent_for(rig, 0.2)
    told = rig.session.exchange(RATES)
    assert not told.on and not rig.session.watched
    assert "heard nothing from the servo" in rig.session.why_off
    rig.talk().ask("JG 5000,5000,5000")
    rig.jog(RATES, 0.1)
    assert rig.off and rig.still
    rig.session.start()
    assert rig.jog(RATES, 0.1).on and not rig.still


@pytest.mark.parametrize("phase", range(11))
def test_somebody_else_who_jogs_once_stops_the_arm_whenever_that_is(phase: int) -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.5)
    other = rig.talk()
    rig.wait(phase * SAMPLE)
    other.ask("JG 700")
    rig.wait((10 - phase) * SAMPLE)
    for _ in range(10):
        told = rig.session.exchange(RATES)
        rig.wait(TICK)
    assert not told.on and rig.still and rig.off
    assert "somebody else sent speeds" in rig.session.why_off


def test_an_earlier_session_that_goes_on_stops_the_arm() -> None:
    rig = Rig().started()
    earlier = rig.session
    silent_for(rig, 0.2)
    rig.session = rig.connected()
    rig.session.start()
    rig.jog(RATES, 0.1)
    earlier.exchange(RATES)
    rig.wait(0.1)
    rig.session.look()
    assert rig.off and rig.still
    assert "earlier session" in rig.session.why_off or "somebody else" in rig.session.why_off


def test_another_host_is_refused_while_one_has_the_arm_and_moves_nothing() -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.1)
    with pytest.raises(NotReady, match="another host has the arm"):
        rig.connected()
    assert rig.jog(RATES, 0.1).on


def test_enabling_does_not_take_the_arm_from_a_host_that_has_it_by_now() -> None:
    """Both were connected while it was free."""
    rig = Rig()
    other = rig.connected()
    rig.started().jog(RATES, 0.1)
    with pytest.raises(NotReady, match="another host has the arm"):
        other.start()
    assert rig.jog(RATES, 0.1).on and not rig.still


def test_enabling_does_not_stop_axes_that_somebody_moves_without_a_program() -> None:
    rig = Rig()
    rig.session.define(HOME)
    rig.talk().ask("SH B", "JG ,500", "BG B")
    with pytest.raises(NotReady, match="the axes ABC move"):
        rig.session.start()
    assert rig.controller.state.axes[1].moving


def test_who_has_it_may_enable_it_again_and_begins_at_rest() -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.2)
    rig.session.start()
    assert rig.session.look().on and rig.jog(np.zeros(3), 0.1).on
    assert not any(axis.speed for axis in rig.controller.state.axes)


@pytest.mark.parametrize(
    ("counts", "axes"),
    [
        ((50000.0, -50000.0, 500.5), "ABC"),
        ((-50000.0, 50000.0, 500.0), "ABC"),
        ((50000.0, -50000.0, 500.0), "BAC"),
    ],
)
def test_whoever_edits_counts_or_axes_must_say_anew_where_the_arm_stands(
    counts: tuple[float, float, float], axes: str
) -> None:
    rig = Rig()
    rig.session.define(HOME)
    assert rig.session.homed() and rig.connected().homed()
    edited = rig.connected(replace(SETTINGS, counts=counts, axes=axes))
    assert not edited.homed()
    with pytest.raises(NotReady, match="counts and axes were changed"):
        edited.start()
    edited.define(HOME)
    assert edited.homed() and not rig.session.homed()


def test_axes_that_somebody_moves_are_left_alone() -> None:
    rig = Rig()
    rig.talk().ask("SH B", "JG ,500", "BG B")
    with pytest.raises(NotReady, match="the axes ABC move"):
        rig.connected()
    assert rig.controller.state.axes[1].moving


def test_a_program_that_somebody_ends_is_noticed_within_a_moment_and_stops_the_arm() -> None:
    for text in ("HX", "ST"):
        rig = Rig().started()
        rig.jog(RATES, 0.1)
        rig.talk().ask(text)
        rig.jog(RATES, 0.1)
        rig.jog(RATES, 0.2)
        assert rig.off and rig.still
        assert rig.session.why_off


def test_a_joint_that_does_not_follow_is_told_by_its_axis() -> None:
    rig = Rig().started()
    rig.controller.stuck = 1
    rig.jog(RATES, 0.4)
    assert rig.off and rig.still
    assert "axis B was switched off because it did not follow" in rig.session.why_off


def tripped_without_program() -> Rig:
    """An arm of which the second motor has gone off after somebody ended the program: nobody stops
    the others."""
    rig = Rig().started()
    rig.jog(RATES, 0.1)
    rig.talk().ask("HX")
    rig.controller.state.axes[1].switch_off(StopCode.OFF_ON_ERROR)
    assert rig.controller.state.axes[0].moving
    return rig


def test_where_one_motor_goes_off_and_no_program_runs_the_others_are_switched_off() -> None:
    rig = tripped_without_program()
    told = rig.session.look()
    assert not told.on
    assert rig.off and rig.still
    assert "axis B was switched off because it did not follow" in rig.session.why_off
    assert not rig.session.watched and rig.session.look().off


def test_until_all_motors_are_off_an_arm_counts_as_watched_over_and_can_be_switched_off() -> None:
    """The program runs and stops the others, but is ended before it has."""
    rig = Rig(replace(SETTINGS, deceleration=(2.0, 2.0, 10.0))).started()
    rig.jog(RATES, 0.2)
    rig.controller.state.axes[1].switch_off(StopCode.OFF_ON_ERROR)
    rig.wait(0.02)
    told = rig.session.look()
    assert not told.on and not told.off
    why = rig.session.why_off
    assert "axis B was switched off because it did not follow" in why
    rig.talk().ask("HX")
    assert rig.session.watched
    rig.session.switch_off()
    assert rig.off and rig.still
    assert not rig.session.watched and rig.session.why_off == why


def test_where_one_motor_is_off_no_speeds_are_sent() -> None:
    rig = Rig(replace(SETTINGS, deceleration=(2.0, 2.0, 10.0))).started()
    rig.jog(RATES, 0.2)
    rig.controller.state.axes[1].switch_off(StopCode.OFF_ON_ERROR)
    rig.session.look()
    speeds = [axis.settings.JG for axis in rig.controller.state.axes]
    rig.session.exchange(-0.5 * RATES)
    assert [axis.settings.JG for axis in rig.controller.state.axes] == speeds


def test_a_limit_of_the_mechanism_is_the_controllers_too() -> None:
    rig = Rig().started()
    rig.jog(np.array([0.0, 0.0, -40.0]), 2.7)
    assert rig.off and rig.still
    assert "axis C was stopped by its reverse limit" in rig.session.why_off
    assert rig.session.look().q[2] > -2.0


def test_switching_off_comes_to_rest_with_the_settings_deceleration() -> None:
    rig = Rig().started()
    told = rig.jog(RATES, 0.5)
    rig.session.switch_off()
    assert rig.off and rig.still
    way = np.abs(rig.session.look().q - told.q)
    assert (way <= RATES**2 / (2 * np.array([10.0, 10.0, 1000.0])) + np.abs(RATES) * 0.02).all()


@pytest.mark.parametrize("before", ["nothing", "rest is asked for", "the program is ended"])
def test_a_gentle_deceleration_is_waited_for_and_not_cut_short_by_an_abort(before: str) -> None:
    """It takes half a second. DC is taken in steps of 1024 counts/s²."""
    gentle = np.array([2.0, 2.0, 10.0])
    rig = Rig(replace(SETTINGS, deceleration=tuple(gentle))).started()
    rates = np.array([0.2, 1.0, -5.0])
    rig.jog(rates, 0.2)
    told = rig.jog(np.zeros(3), 0.0) if before == "rest is asked for" else rig.session.look()
    if before == "the program is ended":
        rig.talk().ask("HX")
    rig.session.switch_off()
    assert rig.off and rig.still
    stops = [axis.stop_code for axis in rig.controller.state.axes[:3]]
    assert stops == [StopCode.COMMAND] * 3
    way = np.abs(rig.session.look().q - told.q)
    assert way[1] == pytest.approx(0.25, abs=0.03)


def test_a_controller_of_another_kind_is_refused() -> None:
    rig = Rig()
    rig.controller.disconnect(0)
    with pytest.raises(NotReady, match="QZ of a DMC-40x0"):
        Rig(GalilSettings(address="x", counts=(1e5, 1e5, 1e3), axes="ABH"))


def test_a_controller_that_is_deaf_is_lost_for_good() -> None:
    rig = Rig().started()
    for wire in rig.wires:
        wire.deaf = True
    with pytest.raises(Lost, match=r"has not answered for 0\.25 s"):
        rig.session.exchange(RATES)
    assert rig.off and rig.still
    with pytest.raises(Lost):
        rig.session.look()


def test_an_amplifier_that_fails_is_told_in_words_and_refuses_to_start() -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.1)
    rig.controller.unpowered = True
    rig.jog(RATES, 0.1)
    assert rig.off and rig.still
    why = rig.session.why_off
    assert "axis A was switched off by a fault of its amplifier" in why
    assert "under-voltage on axes A-D" in why
    with pytest.raises(NotReady, match="amplifiers are not ready: under-voltage on axes A-D"):
        rig.session.start()
    rig.controller.unpowered = False
    rig.wait(0.01)
    rig.session.start()
    assert rig.jog(RATES, 0.1).on


def test_amplifiers_and_sensors_of_other_axes_count_for_nothing() -> None:
    rig = Rig()
    rig.session.define(HOME)
    rig.controller.state.amplifier = [0b01110000, 0b11111000, 0xFF, 0b10]
    rig.session.start()
    assert rig.jog(RATES, 0.1).on


@pytest.mark.parametrize(
    ("told", "axes", "said"),
    [
        ((0b0001, 0, 0), "ABC", ["over-current on axes A-D"]),
        ((0b0110, 0, 0), "ABC", ["over-voltage on axes A-D", "over-temperature on axes A-D"]),
        ((0x80, 0, 0), "AEF", ["under-voltage on axes E-H"]),
        ((0, 0b101, 0), "CBA", ["hall sensor error on axis C", "hall sensor error on axis A"]),
        ((0, 0, 0b01), "ABC", ["electronic lock-out of axes A-D"]),
        ((0, 0, 0b10), "BCH", ["electronic lock-out of axes E-H"]),
        ((0, 0, 0), "ABC", []),
    ],
)
def test_bits_of_the_amplifiers_are_what_the_manual_says(
    told: tuple[int, int, int], axes: str, said: list[str]
) -> None:
    """DMC-40x0 user manual, Amplifier Status: TA0 is bits 0 to 7, TA1 8 to 15, TA3 24 and 25."""
    assert errors(told, axes) == said


@pytest.mark.parametrize("told", [(0, 0), (0, -1, 0), (256, 0, 0), (0, 0, 1e9)])
def test_what_are_no_amplifier_bits_is_refused(told: tuple[float, ...]) -> None:
    with pytest.raises(NotReady, match="must tell three bytes"):
        errors(told, "ABC")


def test_what_the_controller_says_of_its_own_accord_is_read_and_told() -> None:
    rig = Rig().started()
    messages = rig.wires[1].handle
    assert messages is not None
    for number in range(100):
        rig.controller.state.tell(f"hello {number}")
        rig.controller.state.tell("oven is hot" if number == 99 else "")
        rig.jog(RATES, 0.01)
    assert rig.controller.answers(messages) == b"" and not rig.session.why_off
    rig.controller.stuck = 1
    rig.jog(RATES, 0.4)
    assert "did not follow" in rig.session.why_off
    assert "it said 'oven is hot'" in rig.session.why_off
    rig.controller.stuck = None
    rig.session.start()
    assert not rig.session.said


def test_joints_of_an_answer_that_is_held_up_bear_the_time_at_which_they_were_read() -> None:
    rig = Rig().started()
    rig.jog(RATES, 0.2)
    wire, before = rig.wires[0], rig.now()
    receive = wire.receive

    def held_up(seconds: float) -> bytes:
        told = receive(seconds)
        rig.wait(0.015)
        return told

    wire.receive = held_up  # type: ignore[method-assign]
    for _ in range(5):
        told = rig.session.look()
        sample = int(told.rows.general["sample"]) * SAMPLE
        assert told.time == pytest.approx(sample, abs=2e-3)
        assert before - 2e-3 < told.time <= rig.now() - 0.01
        before = rig.now()
