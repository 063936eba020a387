"""Toy arm of examples/udp_arm: its rules, and a complete servo that uses it."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toy_arm import (
    LOWER,
    MAX_RATES,
    OFF_BY_COMMAND,
    OFF_BY_WATCHDOG,
    START,
    UPPER,
    WATCHDOG_TIMEOUT_NS,
    ToyArm,
)
from toy_wire import ASK, ENABLE, JOG, OFF, ToyAnswer, ToyOrder, answer_in, order_in, sent
from udp_arm import MAX_ROUND_TRIP_NS, NoToy, UdpArm

import rcmservo as rs
from conftest import ROOT, make_environment
from stalls import retry_after_stalls

MS = 1_000_000
REST = 0.0, 0.0, 0.0
TURN = 0.5, -0.3, 20.0
SECONDS = "4"
"""Duration in s of a run that reaches the target."""
TOY = ROOT / "examples/udp_arm/toy_arm.py"


def encode_command(kind: int, session: int, number: int = 0, rates: tuple = REST) -> bytes:
    return sent(ToyOrder(kind, session, number, 0, rates))


def enabled_toy(session: int = 7) -> ToyArm:
    toy = ToyArm(0)
    toy.hear(encode_command(ENABLE, session), 0)
    assert toy.on
    return toy


def jog(toy: ToyArm, numbers: list[int], start: int, session: int = 7) -> None:
    """Send a JOG command every 10 ms."""
    for k, number in enumerate(numbers):
        toy.hear(encode_command(JOG, session, number, TURN), start + 10 * MS * k)


def test_the_arm_follows_the_commanded_rates_with_a_small_lag() -> None:
    toy = enabled_toy()
    jog(toy, list(range(1, 101)), 0)
    toy.advance(1000 * MS)
    distance = np.array(toy.q) - START
    np.testing.assert_allclose(distance, np.array(TURN) * (1.0 - 0.015), rtol=1e-9)


def test_the_arm_stops_and_disables_its_drive_when_commands_are_lost() -> None:
    toy = enabled_toy()
    jog(toy, [1, 2, 3], 0)
    toy.advance(20 * MS + WATCHDOG_TIMEOUT_NS)
    assert toy.on
    there = list(toy.q)
    toy.advance(20 * MS + WATCHDOG_TIMEOUT_NS + 1)
    assert not toy.on and toy.why == OFF_BY_WATCHDOG
    jog(toy, [4, 5, 6], 100 * MS)
    toy.hear(encode_command(ENABLE, 8), 130 * MS)
    toy.advance(140 * MS)
    assert toy.on and toy.q == pytest.approx(there, abs=1e-7)


def test_the_stop_position_does_not_depend_on_the_arm_process() -> None:
    """A toy arm whose process stalls stops at its watchdog time-out all the same."""
    soon, late = enabled_toy(), enabled_toy()
    for toy in (soon, late):
        jog(toy, [1, 2], 0)
    for now in range(11, 200):
        soon.advance(now * MS)
    late.advance(10_000 * MS)
    assert soon.q == pytest.approx(late.q, abs=1e-12)


def test_copies_of_a_command_do_not_prolong_the_motion() -> None:
    toy = enabled_toy()
    jog(toy, [1, *10 * [2]], 0)
    assert not toy.on and toy.why == OFF_BY_WATCHDOG


def test_an_older_command_that_arrives_late_is_ignored() -> None:
    toy = enabled_toy()
    toy.hear(encode_command(JOG, 7, 5, TURN), MS)
    toy.hear(encode_command(JOG, 7, 4, (-1.0, 0.0, 0.0)), 2 * MS)
    assert toy.rates == list(TURN) and toy.heard == MS


def test_a_late_copy_of_an_enable_does_not_enable_the_drive() -> None:
    toy = enabled_toy()
    toy.hear(encode_command(OFF, 7), MS)
    assert not toy.on and toy.why == OFF_BY_COMMAND
    toy.hear(encode_command(ENABLE, 7), 2 * MS)
    toy.hear(encode_command(ENABLE, 0), 2 * MS)
    assert not toy.on
    toy.hear(encode_command(ENABLE, 8), 3 * MS)
    toy.hear(encode_command(JOG, 7, 100, TURN), 4 * MS)
    assert toy.on and toy.rates == list(REST)


def test_a_second_sender_can_disable_the_drive_but_not_move_the_arm() -> None:
    toy = enabled_toy()
    jog(toy, [1, 2, 3, 4], 0)
    toy.hear(encode_command(ENABLE, 9), 31 * MS)
    toy.hear(encode_command(JOG, 9, 100, (1.0, 1.0, 100.0)), 32 * MS)
    answer = answer_in(toy.hear(encode_command(ASK, 9), 33 * MS) or b"")
    assert answer is not None and (answer.session, answer.number, answer.on) == (7, 4, True)
    assert answer.rates == TURN
    toy.advance(30 * MS + WATCHDOG_TIMEOUT_NS + 1)
    assert not toy.on
    toy = enabled_toy()
    toy.hear(encode_command(OFF, 9), MS)
    assert not toy.on


def test_speeds_and_positions_are_limited() -> None:
    toy = enabled_toy()
    for k in range(1, 400):
        toy.hear(encode_command(JOG, 7, k, (50.0, -50.0, 1e300)), 10 * MS * k)
        assert (np.abs(toy.rates) <= MAX_RATES).all()
    assert toy.q == [UPPER[0], LOWER[1], UPPER[2]] and toy.rates == list(REST)
    toy.hear(encode_command(JOG, 7, 400, (-0.5, -0.5, 1.0)), 4000 * MS)
    assert toy.rates == [-0.5, 0.0, 0.0]


@given(st.binary(max_size=80) | st.just(encode_command(JOG, 7, 3, TURN)), st.data())
def test_a_damaged_datagram_is_dropped_without_an_answer(text: bytes, data: st.DataObject) -> None:
    if order_in(text) is not None:
        bit = data.draw(st.integers(0, 8 * len(text) - 1))
        damaged = bytearray(text)
        damaged[bit // 8] ^= 1 << bit % 8
        text = bytes(damaged[: data.draw(st.integers(0, len(text)))] if bit % 3 else damaged)
    toy = enabled_toy()
    assert toy.hear(text, MS) is None and answer_in(text) is None
    assert toy.heard == 0 and toy.rates == list(REST)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_a_command_with_an_invalid_rate_is_dropped(number: float) -> None:
    toy = enabled_toy()
    assert toy.hear(encode_command(JOG, 7, 1, (0.1, number, 0.0)), MS) is None
    assert toy.rates == list(REST)


TIMED_COMMANDS = st.tuples(
    st.integers(0, 60),
    st.sampled_from([ASK, ENABLE, JOG, JOG, JOG, OFF]),
    st.integers(0, 3),
    st.integers(0, 8),
    st.tuples(*[st.floats(-2, 2), st.floats(-2, 2), st.floats(-200, 200)]),
)


@given(st.lists(TIMED_COMMANDS, max_size=60))
def test_the_arm_respects_watchdog_speed_and_limits_for_any_datagrams(commands: list) -> None:
    toy, now, before = ToyArm(0), 0, np.array(START)
    for ms, kind, session, number, rates in commands:
        fed, was_on = toy.heard, toy.on
        now += ms * MS
        toy.hear(encode_command(kind, session, number, rates), now)
        moved = np.abs(np.array(toy.q) - before)
        seconds = (
            max(min(now, fed + WATCHDOG_TIMEOUT_NS) - (now - ms * MS), 0) * 1e-9 if was_on else 0.0
        )
        assert (moved <= np.array(MAX_RATES) * seconds + 1e-12).all()
        assert all(a <= q <= b for a, q, b in zip(LOWER, toy.q, UPPER, strict=True))
        before = np.array(toy.q)


def test_the_documentation_names_the_toy_arm_and_its_start_command() -> None:
    page = (ROOT / "docs/own_devices.md").read_text()
    assert f".venv/bin/python {TOY.relative_to(ROOT)} --port 5600\n" in page
    for name in ("toy_arm.py", "toy_wire.py", "udp_arm.py"):
        assert f"](../examples/udp_arm/{name})" in page and TOY.with_name(name).exists()


# tests in wall time, with the toy in a separate process


@contextmanager
def toy(log: Path = Path("/dev/null")) -> Iterator[int]:
    """Run a toy arm and yield its port."""
    command = [sys.executable, str(TOY), "--port", "0", "--log", str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline().split(",")[0].split(":")[1])
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
        finally:
            process.kill()


@pytest.mark.alone
def test_the_driver_enables_the_drive_for_its_own_session_only() -> None:
    with toy() as port, closing(UdpArm("127.0.0.1", port)) as arm:
        assert not arm.measure().enabled and arm.measure().q.tolist() == list(START)
        arm.enable()
        assert arm.measure().time > 0 and not arm.off_reason


@pytest.mark.alone
def test_the_driver_sends_no_invalid_command_and_accepts_no_late_answer() -> None:
    with toy() as port, closing(UdpArm("127.0.0.1", port)) as arm:
        arm.enable()
        now = time.monotonic_ns()
        arm.apply(rs.Command(5, now, now - 1, np.array(TURN), True))
        before = arm.measure().time
        while arm.measure().time < now + 10 * MS:
            arm._new.wait(0.01)
        assert arm._last is not None and arm._last[1].number == 0 and before <= now
        other_joints = (0.0, 0.0, 100.0)
        for stamp in (
            time.monotonic_ns() - MAX_ROUND_TRIP_NS - MS,
            time.monotonic_ns() + 10_000 * MS,
            0,
        ):
            arm._take(sent(ToyAnswer(1, 0, stamp, True, 0, other_joints, REST)))
        assert arm.measure().q.tolist() == list(START)


def answer_as_other_host(wire: socket.socket) -> None:
    """Run a device that another host controls."""
    with suppress(OSError):
        while True:
            datagram, sender = wire.recvfrom(512)
            command = order_in(datagram)
            assert command is not None
            wire.sendto(sent(ToyAnswer(99, 5, command.stamp, True, 0, START, TURN)), sender)


@pytest.mark.alone
def test_the_driver_does_not_take_over_an_arm_of_another_host() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        wire.settimeout(30.0)
        peer = threading.Thread(target=answer_as_other_host, args=(wire,), daemon=True)
        peer.start()
        with closing(UdpArm(*wire.getsockname())) as arm:
            with pytest.raises(NoToy, match="another host uses it"):
                arm.enable()
            assert not arm.measure().enabled


def test_a_missing_arm_is_reported() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as silent:
        silent.bind(("127.0.0.1", 0))
        with pytest.raises(NoToy, match="no toy arm answers"):
            UdpArm("127.0.0.1", silent.getsockname()[1])


def run_toy_servo() -> list[str]:
    """Return the phase at the end of a run, and the joints."""
    script = Path(__file__).with_name("toy_lab.py")
    env = make_environment()
    env["PYTHONPATH"] += os.pathsep + str(TOY.parent)
    with toy() as port:
        command = [sys.executable, str(script), str(port), SECONDS]
        ran = subprocess.run(command, env=env, stdout=subprocess.PIPE, text=True, check=True)
    return ran.stdout.split()


@pytest.mark.alone
@pytest.mark.slow
def test_a_complete_servo_reaches_its_target_over_udp() -> None:
    phase, *q = retry_after_stalls(run_toy_servo, lambda run: run[0] == "SERVO")
    assert phase == "SERVO"
    error = np.abs(np.array(q, float) - [0.75, 0.4, 135.0])
    assert (error < [0.01, 0.01, 1.0]).all()


def rows(log: Path) -> np.ndarray:
    """Return the toy log: time, session, on, reason, time of the last command, three joints."""
    text = log.read_text().replace("True", "1").replace("False", "0")
    return np.array([[float(part) for part in line.split()] for line in text.split("\n")[:-1]])


@pytest.mark.alone
def test_the_watchdog_stops_the_arm_when_commands_stop(tmp_path: Path) -> None:
    """Stop the commands, as when a servo process is killed.

    The log has the toy's own clock: after the last command the arm moves until the watchdog
    time-out.
    """
    log = tmp_path / "toy.log"
    with toy(log) as port, closing(UdpArm("127.0.0.1", port)) as arm:
        arm.enable()
        for number in range(1, 6):
            now = time.monotonic_ns()
            arm.apply(rs.Command(number, now, now + 10**9, np.array(TURN), True))
            arm._new.wait(0.01)
        while not arm.off_reason:
            arm._new.wait(0.01)
        assert arm.off_reason == "its watchdog expired"
    log_rows = rows(log)
    last = np.flatnonzero(log_rows[:, 2])[-1]
    assert (log_rows[: last + 1, 0] <= log_rows[: last + 1, 4] + WATCHDOG_TIMEOUT_NS).all()
    assert np.abs(log_rows[last, 5:] - START).max() > 1e-4
    assert log_rows[-1, 3] == OFF_BY_WATCHDOG and log_rows[-1, 4] == log_rows[last, 4]
    assert (log_rows[last + 1 :, 5:] == log_rows[-1, 5:]).all()
