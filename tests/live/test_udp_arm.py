"""The toy arm of examples/udp_arm keeps the rules that it shows, and a whole servo runs over it."""

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
from toy_arm import FASTEST, LOWER, PATIENCE, RAN_OUT, START, TOLD, UPPER, ToyArm
from toy_wire import ASK, ENABLE, JOG, OFF, ToyAnswer, ToyOrder, answer_in, order_in, sent
from udp_arm import SLOW, NoToy, UdpArm

import rcmservo as rs
from conftest import ROOT, with_tests
from stalls import undisturbed

MS = 1_000_000
REST = 0.0, 0.0, 0.0
TURN = 0.5, -0.3, 20.0
SECONDS = "7"
"""s of a run in which the servo arrives."""
TOY = ROOT / "examples/udp_arm/toy_arm.py"


def order(kind: int, session: int, number: int = 0, rates: tuple = REST) -> bytes:
    return sent(ToyOrder(kind, session, number, 0, rates))


def enabled(session: int = 7) -> ToyArm:
    toy = ToyArm(0)
    toy.hear(order(ENABLE, session), 0)
    assert toy.on
    return toy


def jogged(toy: ToyArm, numbers: list[int], start: int, session: int = 7) -> None:
    """A JOG every 10 ms."""
    for k, number in enumerate(numbers):
        toy.hear(order(JOG, session, number, TURN), start + 10 * MS * k)


def test_it_follows_the_rates_it_is_given_with_a_small_lag() -> None:
    toy = enabled()
    jogged(toy, list(range(1, 101)), 0)
    toy.advance(1000 * MS)
    way = np.array(toy.q) - START
    np.testing.assert_allclose(way, np.array(TURN) * (1.0 - 0.015), rtol=1e-9)


def test_where_orders_are_lost_it_stops_and_switches_off_by_itself() -> None:
    toy = enabled()
    jogged(toy, [1, 2, 3], 0)
    toy.advance(20 * MS + PATIENCE)
    assert toy.on
    there = list(toy.q)
    toy.advance(20 * MS + PATIENCE + 1)
    assert not toy.on and toy.why == RAN_OUT
    jogged(toy, [4, 5, 6], 100 * MS)
    toy.hear(order(ENABLE, 8), 130 * MS)
    toy.advance(140 * MS)
    assert toy.on and toy.q == pytest.approx(there, abs=1e-7)


def test_it_stops_at_the_same_place_however_late_it_looks() -> None:
    """A toy whose process stalls has stood still all the same since its watchdog ran out."""
    soon, late = enabled(), enabled()
    for toy in (soon, late):
        jogged(toy, [1, 2], 0)
    for now in range(11, 200):
        soon.advance(now * MS)
    late.advance(10_000 * MS)
    assert soon.q == pytest.approx(late.q, abs=1e-12)


def test_copies_of_an_order_do_not_keep_it_moving() -> None:
    toy = enabled()
    jogged(toy, [1, *10 * [2]], 0)
    assert not toy.on and toy.why == RAN_OUT


def test_an_older_order_that_comes_late_is_not_obeyed() -> None:
    toy = enabled()
    toy.hear(order(JOG, 7, 5, TURN), MS)
    toy.hear(order(JOG, 7, 4, (-1.0, 0.0, 0.0)), 2 * MS)
    assert toy.rates == list(TURN) and toy.heard == MS


def test_a_late_copy_of_an_enable_does_not_switch_it_on() -> None:
    toy = enabled()
    toy.hear(order(OFF, 7), MS)
    assert not toy.on and toy.why == TOLD
    toy.hear(order(ENABLE, 7), 2 * MS)
    toy.hear(order(ENABLE, 0), 2 * MS)
    assert not toy.on
    toy.hear(order(ENABLE, 8), 3 * MS)
    toy.hear(order(JOG, 7, 100, TURN), 4 * MS)
    assert toy.on and toy.rates == list(REST)


def test_a_second_sender_moves_nothing_and_takes_nothing_but_may_switch_off() -> None:
    toy = enabled()
    jogged(toy, [1, 2, 3, 4], 0)
    toy.hear(order(ENABLE, 9), 31 * MS)
    toy.hear(order(JOG, 9, 100, (1.0, 1.0, 100.0)), 32 * MS)
    answer = answer_in(toy.hear(order(ASK, 9), 33 * MS) or b"")
    assert answer is not None and (answer.session, answer.number, answer.on) == (7, 4, True)
    assert answer.rates == TURN
    toy.advance(30 * MS + PATIENCE + 1)
    assert not toy.on
    toy = enabled()
    toy.hear(order(OFF, 9), MS)
    assert not toy.on


def test_speeds_and_places_have_limits() -> None:
    toy = enabled()
    for k in range(1, 400):
        toy.hear(order(JOG, 7, k, (50.0, -50.0, 1e300)), 10 * MS * k)
        assert (np.abs(toy.rates) <= FASTEST).all()
    assert toy.q == [UPPER[0], LOWER[1], UPPER[2]] and toy.rates == list(REST)
    toy.hear(order(JOG, 7, 400, (-0.5, -0.5, 1.0)), 4000 * MS)
    assert toy.rates == [-0.5, 0.0, 0.0]


@given(st.binary(max_size=80) | st.just(order(JOG, 7, 3, TURN)), st.data())
def test_what_is_damaged_is_dropped_without_an_answer(text: bytes, data: st.DataObject) -> None:
    if order_in(text) is not None:
        bit = data.draw(st.integers(0, 8 * len(text) - 1))
        damaged = bytearray(text)
        damaged[bit // 8] ^= 1 << bit % 8
        text = bytes(damaged[: data.draw(st.integers(0, len(text)))] if bit % 3 else damaged)
    toy = enabled()
    assert toy.hear(text, MS) is None and answer_in(text) is None
    assert toy.heard == 0 and toy.rates == list(REST)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_a_rate_that_is_no_number_is_dropped(number: float) -> None:
    toy = enabled()
    assert toy.hear(order(JOG, 7, 1, (0.1, number, 0.0)), MS) is None
    assert toy.rates == list(REST)


ORDERS = st.tuples(
    st.integers(0, 60),
    st.sampled_from([ASK, ENABLE, JOG, JOG, JOG, OFF]),
    st.integers(0, 3),
    st.integers(0, 8),
    st.tuples(*[st.floats(-2, 2), st.floats(-2, 2), st.floats(-200, 200)]),
)


@given(st.lists(ORDERS, max_size=60))
def test_whatever_comes_it_moves_within_its_watchdog_its_speed_and_its_limits(orders: list) -> None:
    toy, now, before = ToyArm(0), 0, np.array(START)
    for ms, kind, session, number, rates in orders:
        fed, was_on = toy.heard, toy.on
        now += ms * MS
        toy.hear(order(kind, session, number, rates), now)
        moved = np.abs(np.array(toy.q) - before)
        seconds = max(min(now, fed + PATIENCE) - (now - ms * MS), 0) * 1e-9 if was_on else 0.0
        assert (moved <= np.array(FASTEST) * seconds + 1e-12).all()
        assert all(a <= q <= b for a, q, b in zip(LOWER, toy.q, UPPER, strict=True))
        before = np.array(toy.q)


def test_the_page_names_the_toy_and_how_it_is_started() -> None:
    page = (ROOT / "docs/own_devices.md").read_text()
    assert f".venv/bin/python {TOY.relative_to(ROOT)} --port 5600\n" in page
    for name in ("toy_arm.py", "toy_wire.py", "udp_arm.py"):
        assert f"](../examples/udp_arm/{name})" in page and TOY.with_name(name).exists()


# what follows runs in wall time, with the toy in a process of its own


@contextmanager
def toy(log: Path = Path("/dev/null")) -> Iterator[int]:
    """The port of a toy that runs."""
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
def test_the_driver_switches_on_for_itself_alone() -> None:
    with toy() as port, closing(UdpArm("127.0.0.1", port)) as arm:
        assert not arm.measure().enabled and arm.measure().q.tolist() == list(START)
        arm.enable()
        assert arm.measure().time > 0 and not arm.why_off


@pytest.mark.alone
def test_the_driver_sends_no_command_that_is_void_and_believes_no_answer_that_is_late() -> None:
    with toy() as port, closing(UdpArm("127.0.0.1", port)) as arm:
        arm.enable()
        now = time.monotonic_ns()
        arm.apply(rs.Command(5, now, now - 1, np.array(TURN), True))
        before = arm.measure().time
        while arm.measure().time < now + 10 * MS:
            arm._new.wait(0.01)
        assert arm._last is not None and arm._last[1].number == 0 and before <= now
        elsewhere = (0.0, 0.0, 100.0)
        for stamp in (time.monotonic_ns() - SLOW - MS, time.monotonic_ns() + 10_000 * MS, 0):
            arm._take(sent(ToyAnswer(1, 0, stamp, True, 0, elsewhere, REST)))
        assert arm.measure().q.tolist() == list(START)


def answering(wire: socket.socket) -> None:
    """A device that somebody else has."""
    with suppress(OSError):
        while True:
            datagram, sender = wire.recvfrom(512)
            asked = order_in(datagram)
            assert asked is not None
            wire.sendto(sent(ToyAnswer(99, 5, asked.stamp, True, 0, START, TURN)), sender)


@pytest.mark.alone
def test_a_toy_that_another_host_has_is_not_taken_from_it() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        wire.settimeout(30.0)
        peer = threading.Thread(target=answering, args=(wire,), daemon=True)
        peer.start()
        with closing(UdpArm(*wire.getsockname())) as arm:
            with pytest.raises(NoToy, match="another host has it"):
                arm.enable()
            assert not arm.measure().enabled


def test_where_nobody_answers_it_says_so() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as deaf:
        deaf.bind(("127.0.0.1", 0))
        with pytest.raises(NoToy, match="no toy arm answers"):
            UdpArm("127.0.0.1", deaf.getsockname()[1])


def servoed() -> list[str]:
    """The phase at the end of a run, and the joints."""
    script = Path(__file__).with_name("toy_lab.py")
    env = with_tests()
    env["PYTHONPATH"] += os.pathsep + str(TOY.parent)
    with toy() as port:
        command = [sys.executable, str(script), str(port), SECONDS]
        ran = subprocess.run(command, env=env, stdout=subprocess.PIPE, text=True, check=True)
    return ran.stdout.split()


@pytest.mark.alone
@pytest.mark.slow
def test_a_whole_servo_goes_to_its_target_over_it() -> None:
    phase, *q = undisturbed(servoed, lambda told: told[0] == "SERVO")
    assert phase == "SERVO"
    away = np.abs(np.array(q, float) - [0.75, 0.4, 135.0])
    assert (away < [0.01, 0.01, 1.0]).all()


def rows(log: Path) -> np.ndarray:
    """Of the toy's log: time, session, on, why, heard, and three joints."""
    text = log.read_text().replace("True", "1").replace("False", "0")
    return np.array([[float(part) for part in line.split()] for line in text.split("\n")[:-1]])


@pytest.mark.alone
def test_when_its_orders_stop_the_toy_stands_still_by_its_own_watchdog(tmp_path: Path) -> None:
    """As when a servo is killed. Its log has its own time: after the last order it moves for as
    long as its watchdog waits.
    """
    log = tmp_path / "toy.log"
    with toy(log) as port, closing(UdpArm("127.0.0.1", port)) as arm:
        arm.enable()
        for number in range(1, 6):
            now = time.monotonic_ns()
            arm.apply(rs.Command(number, now, now + 10**9, np.array(TURN), True))
            arm._new.wait(0.01)
        while not arm.why_off:
            arm._new.wait(0.01)
        assert arm.why_off == "its watchdog ran out"
    told = rows(log)
    last = np.flatnonzero(told[:, 2])[-1]
    assert (told[: last + 1, 0] <= told[: last + 1, 4] + PATIENCE).all()
    assert np.abs(told[last, 5:] - START).max() > 1e-4
    assert told[-1, 3] == RAN_OUT and told[-1, 4] == told[last, 4]
    assert (told[last + 1 :, 5:] == told[-1, 5:]).all()
