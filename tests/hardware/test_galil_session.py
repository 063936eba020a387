"""Session of the driver with an emulated controller, in simulated time."""

from dataclasses import replace

import numpy as np
import pytest
from galil_measures import HOME, LIMITS, RATES, SETTINGS, EmulatedStream, IdealMotors

from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.galil.connection import ConnectionLost, GalilConnection
from rcmservo.hardware.galil.emulator.axis import StopCode
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, GalilController
from rcmservo.hardware.galil.session import ArmReading, GalilSession
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.stop_reasons import decode_amplifier_errors
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import NotReady

TICK = 0.01


class Rig:
    """Session with an emulated controller, and further hosts."""

    def __init__(
        self, settings: GalilSettings = SETTINGS, stream_type: type[EmulatedStream] = EmulatedStream
    ) -> None:
        self.motors = IdealMotors()
        self.controller = GalilController(self.motors)
        self.stream_type, self.streams = stream_type, list[EmulatedStream]()
        self.session = self.new_session(settings)

    def new_session(
        self, settings: GalilSettings = SETTINGS, limits: JointLimits = LIMITS
    ) -> GalilSession:
        connections = [self.connect(settings.reply_timeout) for _ in range(2)]
        session = GalilSession(*connections, settings, limits)
        session.set_up()
        return session

    def connect(self, timeout: float = 0.25) -> GalilConnection:
        self.streams.append(self.stream_type(self.controller))
        return GalilConnection(self.streams[-1], timeout, self.now)

    def now(self) -> float:
        return self.controller.state.samples * SAMPLE_TIME_S

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / SAMPLE_TIME_S)):
            self.controller.sample()

    def start(self) -> "Rig":
        self.session.set_position(HOME)
        self.session.start()
        return self

    def jog(self, rates: Floats, seconds: float) -> ArmReading:
        """Send speeds every 10 ms, as the loop does."""
        reading = self.session.exchange(rates)
        for _ in range(round(seconds / TICK)):
            self.wait(TICK)
            reading = self.session.exchange(rates)
        return reading

    @property
    def at_rest(self) -> bool:
        return not any(axis.moving or axis.speed for axis in self.controller.state.axes)

    @property
    def motors_off(self) -> bool:
        return all(axis.motor_off for axis in self.controller.state.axes[:3])


def test_joints_move_at_their_rates_with_the_signs_and_units_of_the_settings() -> None:
    rig = Rig().start()
    first, first_time = rig.jog(RATES, 0.3), rig.now()
    last = rig.jog(RATES, 0.5)
    assert (last.q - first.q) / (rig.now() - first_time) == pytest.approx(RATES, rel=0.01)
    assert first.all_on and last.all_on
    counts = rig.motors.counts
    assert counts[0] > 0 and counts[1] < 0 and counts[2] < 0


def test_the_position_that_an_operator_sets_is_reported() -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    assert rig.session.read().q == pytest.approx(HOME, abs=1e-3)


def test_the_arm_cannot_start_before_its_position_is_set_and_a_reset_clears_it() -> None:
    rig = Rig()
    with pytest.raises(NotReady, match="the arm's position is not set"):
        rig.session.start()
    rig.start()
    rig.controller.reset()
    with pytest.raises(ConnectionLost):
        rig.session.read()
    other = rig.new_session()
    assert not other.is_homed()
    with pytest.raises(NotReady, match="position is not set"):
        other.start()


def stopping_times(rig: Rig, seconds: float) -> tuple[float, float]:
    """Return the times (s) without commands until the axes are at rest and the motors are off."""
    start, rest_time, off_time = rig.now(), np.inf, np.inf
    while rig.now() - start < seconds:
        rig.wait(SAMPLE_TIME_S)
        rest_time = min(rest_time, rig.now() - start) if rig.at_rest else np.inf
        off_time = min(off_time, rig.now() - start) if rig.motors_off else np.inf
    return rest_time, off_time


def test_the_controller_alone_stops_the_arm_of_a_silent_host() -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.5)
    rest_time, off_time = stopping_times(rig, 0.5)
    ramp_time = max(0.3 / 10.0, 20.0 / 1000.0)
    assert 0.03 < rest_time < SETTINGS.command_timeout + ramp_time + 0.01
    assert off_time < rest_time + 0.01


def test_commands_after_a_stop_by_the_controller_move_nothing_until_the_next_start() -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.5)
    stopping_times(rig, 0.2)
    reading = rig.session.exchange(RATES)
    assert not reading.all_on and not rig.session.is_active
    assert "received no command from the servo" in rig.session.off_reason
    rig.connect().execute("JG 5000,5000,5000")
    rig.jog(RATES, 0.1)
    assert rig.motors_off and rig.at_rest
    rig.session.start()
    assert rig.jog(RATES, 0.1).all_on and not rig.at_rest


@pytest.mark.parametrize("phase", range(11))
def test_a_single_jog_of_another_host_stops_the_arm_at_any_time(phase: int) -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.5)
    other = rig.connect()
    rig.wait(phase * SAMPLE_TIME_S)
    other.execute("JG 700")
    rig.wait((10 - phase) * SAMPLE_TIME_S)
    for _ in range(10):
        reading = rig.session.exchange(RATES)
        rig.wait(TICK)
    assert not reading.all_on and rig.at_rest and rig.motors_off
    assert "another host sent speeds" in rig.session.off_reason


def test_a_command_of_an_earlier_session_stops_the_arm() -> None:
    rig = Rig().start()
    earlier = rig.session
    stopping_times(rig, 0.2)
    rig.session = rig.new_session()
    rig.session.start()
    rig.jog(RATES, 0.1)
    earlier.exchange(RATES)
    rig.wait(0.1)
    rig.session.read()
    assert rig.motors_off and rig.at_rest
    assert "earlier session" in rig.session.off_reason or "another host" in rig.session.off_reason


def test_a_second_host_is_refused_and_the_first_continues() -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.1)
    with pytest.raises(NotReady, match="another host uses the arm"):
        rig.new_session()
    assert rig.jog(RATES, 0.1).all_on


def test_a_session_cannot_start_while_another_one_uses_the_arm() -> None:
    """Both connected while the arm was free."""
    rig = Rig()
    other = rig.new_session()
    rig.start().jog(RATES, 0.1)
    with pytest.raises(NotReady, match="another host uses the arm"):
        other.start()
    assert rig.jog(RATES, 0.1).all_on and not rig.at_rest


def test_a_start_does_not_stop_axes_that_another_host_moves() -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    rig.connect().execute("SH B", "JG ,500", "BG B")
    with pytest.raises(NotReady, match="the axes ABC move"):
        rig.session.start()
    assert rig.controller.state.axes[1].moving


def test_a_restart_begins_at_rest() -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.2)
    rig.session.start()
    assert rig.session.read().all_on and rig.jog(np.zeros(3), 0.1).all_on
    assert not any(axis.speed for axis in rig.controller.state.axes)


@pytest.mark.parametrize(
    ("counts", "axes"),
    [
        ((50000.0, -50000.0, 500.5), "ABC"),
        ((-50000.0, 50000.0, 500.0), "ABC"),
        ((50000.0, -50000.0, 500.0), "BAC"),
    ],
)
def test_changed_counts_or_axes_require_a_new_position(
    counts: tuple[float, float, float], axes: str
) -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    assert rig.session.is_homed() and rig.new_session().is_homed()
    edited = rig.new_session(replace(SETTINGS, counts=counts, axes=axes))
    assert not edited.is_homed()
    with pytest.raises(NotReady, match="counts and axes were changed"):
        edited.start()
    edited.set_position(HOME)
    assert edited.is_homed() and not rig.session.is_homed()


def test_set_up_does_not_stop_axes_that_another_host_moves() -> None:
    rig = Rig()
    rig.connect().execute("SH B", "JG ,500", "BG B")
    with pytest.raises(NotReady, match="the axes ABC move"):
        rig.new_session()
    assert rig.controller.state.axes[1].moving


def test_an_ended_watchdog_program_stops_the_arm() -> None:
    for text in ("HX", "ST"):
        rig = Rig().start()
        rig.jog(RATES, 0.1)
        rig.connect().execute(text)
        rig.jog(RATES, 0.1)
        rig.jog(RATES, 0.2)
        assert rig.motors_off and rig.at_rest
        assert rig.session.off_reason


def test_a_following_error_is_reported_with_its_axis() -> None:
    rig = Rig().start()
    rig.controller.stuck = 1
    rig.jog(RATES, 0.4)
    assert rig.motors_off and rig.at_rest
    assert "axis B was switched off by a following error" in rig.session.off_reason


def rig_with_one_motor_off() -> Rig:
    """Return an arm whose second motor is off after another host ended the program.

    Nothing on the controller stops the other axes.
    """
    rig = Rig().start()
    rig.jog(RATES, 0.1)
    rig.connect().execute("HX")
    rig.controller.state.axes[1].switch_off(StopCode.OFF_ON_ERROR)
    assert rig.controller.state.axes[0].moving
    return rig


def test_the_driver_switches_all_motors_off_after_one_tripped_without_a_program() -> None:
    rig = rig_with_one_motor_off()
    reading = rig.session.read()
    assert not reading.all_on
    assert rig.motors_off and rig.at_rest
    assert "axis B was switched off by a following error" in rig.session.off_reason
    assert not rig.session.is_active and rig.session.read().all_off


def test_an_arm_can_be_switched_off_until_all_its_motors_are_off() -> None:
    """The program is ended while it stops the other axes."""
    rig = Rig(replace(SETTINGS, deceleration=(2.0, 2.0, 10.0))).start()
    rig.jog(RATES, 0.2)
    rig.controller.state.axes[1].switch_off(StopCode.OFF_ON_ERROR)
    rig.wait(0.02)
    reading = rig.session.read()
    assert not reading.all_on and not reading.all_off
    reason = rig.session.off_reason
    assert "axis B was switched off by a following error" in reason
    rig.connect().execute("HX")
    assert rig.session.is_active
    rig.session.switch_off()
    assert rig.motors_off and rig.at_rest
    assert not rig.session.is_active and rig.session.off_reason == reason


def test_no_speeds_are_sent_while_one_motor_is_off() -> None:
    rig = Rig(replace(SETTINGS, deceleration=(2.0, 2.0, 10.0))).start()
    rig.jog(RATES, 0.2)
    rig.controller.state.axes[1].switch_off(StopCode.OFF_ON_ERROR)
    rig.session.read()
    speeds = [axis.settings.JG for axis in rig.controller.state.axes]
    rig.session.exchange(-0.5 * RATES)
    assert [axis.settings.JG for axis in rig.controller.state.axes] == speeds


def test_the_joint_limits_are_soft_limits_of_the_controller() -> None:
    rig = Rig().start()
    rig.jog(np.array([0.0, 0.0, -40.0]), 2.7)
    assert rig.motors_off and rig.at_rest
    assert "axis C was stopped by its reverse limit" in rig.session.off_reason
    assert rig.session.read().q[2] > -2.0


def test_a_switch_off_decelerates_as_set() -> None:
    rig = Rig().start()
    before = rig.jog(RATES, 0.5)
    rig.session.switch_off()
    assert rig.motors_off and rig.at_rest
    distance = np.abs(rig.session.read().q - before.q)
    assert (
        distance <= RATES**2 / (2 * np.array([10.0, 10.0, 1000.0])) + np.abs(RATES) * 0.02
    ).all()


@pytest.mark.parametrize("case", ["moving", "zero speed sent", "program ended"])
def test_a_switch_off_waits_for_a_slow_deceleration_without_an_abort(case: str) -> None:
    """The deceleration takes half a second. DC has steps of 1024 counts/s²."""
    deceleration = np.array([2.0, 2.0, 10.0])
    rig = Rig(replace(SETTINGS, deceleration=tuple(deceleration))).start()
    rates = np.array([0.2, 1.0, -5.0])
    rig.jog(rates, 0.2)
    start = rig.jog(np.zeros(3), 0.0) if case == "zero speed sent" else rig.session.read()
    if case == "program ended":
        rig.connect().execute("HX")
    rig.session.switch_off()
    assert rig.motors_off and rig.at_rest
    stops = [axis.stop_code for axis in rig.controller.state.axes[:3]]
    assert stops == [StopCode.COMMAND] * 3
    distance = np.abs(rig.session.read().q - start.q)
    assert distance[1] == pytest.approx(0.25, abs=0.03)


def test_a_controller_without_the_axes_is_refused() -> None:
    rig = Rig()
    rig.controller.disconnect(0)
    with pytest.raises(NotReady, match="QZ of a DMC-40x0"):
        Rig(GalilSettings(address="x", counts=(1e5, 1e5, 1e3), axes="ABH"))


def test_a_controller_that_does_not_answer_is_lost_for_good() -> None:
    rig = Rig().start()
    for stream in rig.streams:
        stream.deaf = True
    with pytest.raises(ConnectionLost, match=r"has not answered for 0\.25 s"):
        rig.session.exchange(RATES)
    assert rig.motors_off and rig.at_rest
    with pytest.raises(ConnectionLost):
        rig.session.read()


def test_an_amplifier_error_is_described_and_prevents_a_start() -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.1)
    rig.controller.unpowered = True
    rig.jog(RATES, 0.1)
    assert rig.motors_off and rig.at_rest
    reason = rig.session.off_reason
    assert "axis A was switched off by a fault of its amplifier" in reason
    assert "under-voltage on axes A-D" in reason
    with pytest.raises(NotReady, match="amplifiers are not ready: under-voltage on axes A-D"):
        rig.session.start()
    rig.controller.unpowered = False
    rig.wait(0.01)
    rig.session.start()
    assert rig.jog(RATES, 0.1).all_on


def test_amplifiers_and_sensors_of_other_axes_are_ignored() -> None:
    rig = Rig()
    rig.session.set_position(HOME)
    rig.controller.state.amplifier = [0b01110000, 0b11111000, 0xFF, 0b10]
    rig.session.start()
    assert rig.jog(RATES, 0.1).all_on


@pytest.mark.parametrize(
    ("values", "axes", "errors"),
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
def test_amplifier_bits_are_decoded_as_in_the_manual(
    values: tuple[int, int, int], axes: str, errors: list[str]
) -> None:
    """DMC-40x0 user manual, Amplifier Status: TA0 is bits 0 to 7, TA1 8 to 15, TA3 24 and 25."""
    assert decode_amplifier_errors(values, axes) == errors


@pytest.mark.parametrize("values", [(0, 0), (0, -1, 0), (256, 0, 0), (0, 0, 1e9)])
def test_invalid_amplifier_bits_are_refused(values: tuple[float, ...]) -> None:
    with pytest.raises(NotReady, match="must return three bytes"):
        decode_amplifier_errors(values, "ABC")


def test_unsolicited_messages_are_read_and_added_to_the_reason() -> None:
    rig = Rig().start()
    messages = rig.streams[1].handle
    assert messages is not None
    for number in range(100):
        rig.controller.state.send_message(f"hello {number}")
        rig.controller.state.send_message("oven is hot" if number == 99 else "")
        rig.jog(RATES, 0.01)
    assert rig.controller.take_output(messages) == b"" and not rig.session.off_reason
    rig.controller.stuck = 1
    rig.jog(RATES, 0.4)
    assert "following error" in rig.session.off_reason
    assert "its last message was 'oven is hot'" in rig.session.off_reason
    rig.controller.stuck = None
    rig.session.start()
    assert not rig.session.last_message


def test_joints_of_a_delayed_reply_have_the_time_of_their_sample() -> None:
    rig = Rig().start()
    rig.jog(RATES, 0.2)
    stream, before = rig.streams[0], rig.now()
    receive = stream.receive

    def receive_late(seconds: float) -> bytes:
        data = receive(seconds)
        rig.wait(0.015)
        return data

    stream.receive = receive_late  # type: ignore[method-assign]
    for _ in range(5):
        reading = rig.session.read()
        sample = int(reading.record.general["sample"]) * SAMPLE_TIME_S
        assert reading.time == pytest.approx(sample, abs=2e-3)
        assert before - 2e-3 < reading.time <= rig.now() - 0.01
        before = rig.now()
