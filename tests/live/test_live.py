"""The live loop: the wire and the frames between processes, the arm behind its wire, and the one
who watches.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from contextlib import closing
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import wait

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import with_tests
from rcmservo.config.rig_file import Lab
from rcmservo.errors import BadInput, RcmServoError, UnusableFile
from rcmservo.interfaces import Command, Frame
from rcmservo.live.arm_datagrams import (
    MARK,
    ArmAction,
    ArmRequest,
    ArmState,
    Done,
    NoAnswer,
    RemoteArm,
    SessionCommand,
    arm_socket_path,
    decode,
    encode,
    open_socket,
    receive,
)
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.loop_statistics import Report
from rcmservo.live.shared_ring import EMPTY, HEAD
from rcmservo.live.supervisor import (
    MAX_SILENT_POLLS,
    POLL_NS,
    ServoProcess,
    ignore_report,
    supervise,
)
from rcmservo.recording.reader import read_record
from rcmservo.safety.thresholds import Thresholds
from rcmservo.safety.watchdog import PATIENCE
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings
from rcmservo.sim.processes.arm_process import ArmDevice
from rcmservo.sim.processes.camera_process import LoggedArm
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.processes.motion_log import MotionLog, find_stop
from rcmservo.sim.rig_file import read_rig_settings
from stalls import undisturbed

MS = 1_000_000
DEADLINE = 300.0
"""s after which a test gives up waiting."""

# ---------------------------------------------------------------- the wire

whole = st.integers(-(2**63), 2**63 - 1)
session = st.integers(0, 2**64 - 1)
three = st.lists(st.floats(), min_size=3, max_size=3).map(np.array)
messages = st.one_of(
    st.builds(
        SessionCommand, session, st.builds(Command, whole, whole, whole, three, st.booleans())
    ),
    st.builds(ArmRequest, whole, session, st.sampled_from(ArmAction)),
    st.builds(ArmState, session, whole, three, st.booleans(), three, whole),
    st.builds(Done, whole),
)


@given(messages)
def test_a_message_comes_out_of_the_wire_as_it_went_in_bit_for_bit(message):
    out = decode(encode(message))
    assert type(out) is type(message)
    assert encode(out) == encode(message)


@given(messages, st.data())
def test_a_datagram_that_is_cut_or_lengthened_or_has_a_flipped_bit_is_no_message(message, data):
    sent = encode(message)
    assert decode(sent[: data.draw(st.integers(0, len(sent) - 1))]) is None
    assert decode(sent + data.draw(st.binary(min_size=1, max_size=8))) is None
    place = data.draw(st.integers(0, 8 * len(sent) - 1))
    flipped = bytearray(sent)
    flipped[place // 8] ^= 1 << place % 8
    assert decode(bytes(flipped)) is None


@given(st.binary(max_size=200), st.integers(0, 255))
def test_noise_is_no_message_even_with_a_good_checksum(noise, kind):
    assert decode(noise) is None
    summed = MARK + bytes([kind]) + noise
    out = decode(summed + zlib.crc32(summed).to_bytes(4, "little"))
    assert out is None or encode(out) == summed + zlib.crc32(summed).to_bytes(4, "little")


# ---------------------------------------------------------------- the frames

context = get_context("spawn")


def picture(number, grey=0, size=(4, 6, 3)):
    return Frame(number, number, number + 1, image=np.full(size, grey, dtype=np.uint8))


def test_the_newest_picture_comes_out_of_the_ring_as_it_went_in_and_stays_the_same_object():
    ring = FrameRing(context, 6, 4)
    camera = RingCamera(ring)
    assert camera.latest() is None
    for number in range(30):
        ring.publish(picture(2 * number, 255 - number))
        ring.publish(picture(2 * number + 1, number))
        frame = camera.latest()
        assert (frame.number, frame.exposure, frame.arrival) == (
            2 * number + 1,
            2 * number + 1,
            2 * number + 2,
        )
        assert (frame.image == number).all()
        assert camera.latest() is frame


def test_a_picture_being_overwritten_is_not_used_and_a_damaged_one_comes_without_its_pixels():
    ring = FrameRing(context, 6, 4)
    camera = RingCamera(ring)
    ring.publish(picture(1))
    first = camera.latest()
    ring.publish(picture(2))
    HEAD.pack_into(ring.entries.slot(1), 0, EMPTY, 0, 0)
    assert camera.latest() is first
    ring.publish(picture(3))
    ring.entries.slot(2)[-1] ^= 1
    assert camera.latest().number == 3
    assert camera.latest().image is None


def test_a_picture_of_another_shape_does_not_get_into_the_ring():
    ring = FrameRing(context, 6, 4)
    for frame in (picture(1, size=(6, 4, 3)), Frame(1, 1, 1)):
        with pytest.raises(BadInput):
            ring.publish(frame)
    with pytest.raises(BadInput):
        FrameRing(context, 0, 4)


# ---------------------------------------------------------------- the arm behind its wire


class Lone:
    """A device whose clock the test holds, and a host's wire to it."""

    def __init__(self, folder):
        self.now = 5_000 * MS
        self.log = MotionLog(context)
        self.wire = open_socket(arm_socket_path(folder))
        self.device = ArmDevice(Rig(1, pictures=False), self.wire, self.log, self.now)
        self.host = open_socket(folder / "host")
        self.host.connect(str(arm_socket_path(folder)))

    def close(self):
        self.wire.close()
        self.host.close()

    def turn(self, wait=0):
        self.now += wait
        self.device.step(self.now)

    def send(self, message, wait=0):
        self.host.send(message if isinstance(message, bytes) else encode(message))
        self.turn(wait)

    def enable(self, session=7):
        self.send(ArmRequest(self.now, session, ArmAction.ENABLE))

    def command(self, number, rates=(0.1, 0.0, 0.0), session=7, enabled=True):
        return SessionCommand(
            session, Command(number, self.now, self.now + PATIENCE, np.array(rates), enabled)
        )

    @property
    def taken(self):
        """The rates that the arm takes."""
        return self.device.arm.watchdog.rates.tolist()

    @property
    def on(self):
        return self.device.arm.watchdog.enabled


@pytest.fixture
def lone(tmp_path):
    with closing(Lone(tmp_path)) as lone:
        yield lone


def test_the_arm_follows_valid_commands_of_the_session_that_switched_it_on(lone):
    before = lone.device.arm.q_true
    lone.enable()
    for k in range(20):
        lone.send(lone.command(k, (0.2, 0.0, -10.0)), 10 * MS)
    moved = lone.device.arm.q_true - before
    assert lone.on
    assert moved[0] > 0.01
    assert moved[2] < -0.5
    lone.turn(PATIENCE + 2 * MS)
    assert not lone.on
    assert not lone.log.last()["applied"].any()


junk = st.lists(
    st.one_of(
        st.binary(max_size=100),
        messages.filter(
            lambda m: not (isinstance(m, SessionCommand) and not m.command.enabled)
        ).map(encode),
    ),
    max_size=6,
)


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    with closing(Lone(tmp_path_factory.mktemp("arm"))) as lone:
        yield lone


@given(noise=st.lists(junk, min_size=5, max_size=5), start=st.integers(0, 3))
def test_whatever_else_arrives_the_drive_is_off_one_patience_after_the_last_valid_command(
    held, noise, start
):
    held.turn(MS)
    held.enable()
    order = encode(held.command(start))
    held.send(order)
    assert held.on
    for some in noise:
        for one in (*some, order, order[:-1]):
            held.send(one)
        held.turn(PATIENCE // 5 + MS)
    assert not held.on
    assert not any(held.taken)


def test_what_a_person_asked_for_once_is_not_done_again_when_the_datagram_comes_again(lone):
    ask = encode(ArmRequest(lone.now, 7, ArmAction.ENABLE))
    lone.send(ask)
    assert lone.on
    lone.turn(PATIENCE + 2 * MS)
    assert not lone.on
    lone.send(ask)
    assert not lone.on
    lone.send(ArmRequest(lone.now + 1, 7, ArmAction.ENABLE))
    lone.send(ArmRequest(lone.now - 2_000 * MS, 7, ArmAction.ENABLE))
    assert not lone.on
    lone.send(ArmRequest(lone.now, 7, ArmAction.ENABLE))
    assert lone.on


def test_a_servo_of_an_earlier_session_can_stop_the_arm_but_not_move_it(lone):
    lone.enable(session=1)
    lone.send(lone.command(50, session=1))
    lone.turn(PATIENCE * 2)
    lone.enable(session=2)
    lone.send(lone.command(51, (1.0, 1.0, 10.0), session=1))
    assert lone.on
    assert not any(lone.taken)
    lone.send(lone.command(0, (0.1, 0.0, 0.0), session=2))
    assert lone.taken == [0.1, 0.0, 0.0]
    lone.send(lone.command(52, session=1, enabled=False))
    assert not lone.on


def test_who_takes_over_a_moving_arm_finds_it_at_rest(lone):
    lone.enable(session=1)
    for k in range(5):
        lone.send(lone.command(k, (0.5, 0.0, 0.0), session=1), 10 * MS)
    lone.enable(session=2)
    lone.turn(20 * MS)
    rows = lone.log.since(lone.log.count - 5)
    assert np.ptp(rows["q"], axis=0).max() < 1e-3
    assert lone.on


def test_a_stall_of_the_emulator_is_none_of_the_arm(lone):
    lone.enable()
    for k in range(8):
        lone.host.send(encode(lone.command(k)))
        lone.now += 10 * MS
    lone.turn()
    assert lone.on
    assert lone.log.rows["time"][lone.log.count - 1] >= lone.now


def test_the_log_tells_where_the_joints_were(lone):
    lone.enable()
    for k in range(10):
        lone.send(lone.command(k, (0.5, 0.0, 0.0)), 10 * MS)
    rows, camera_side = lone.log.since(0), LoggedArm(lone.log)
    for i in (5, 60, len(rows) - 2):
        halfway = (rows["q"][i] + rows["q"][i + 1]) / 2.0
        assert np.allclose(
            camera_side.joints_at(int(rows["time"][i]) + MS // 2), halfway, atol=1e-12
        )
    assert np.array_equal(camera_side.joints_at(int(rows["time"][-1]) + 9 * MS), rows["q"][-1])
    assert np.array_equal(camera_side.joints_at(0), rows["q"][0])
    assert find_stop(rows) is None
    lone.turn(PATIENCE + 5 * MS)
    taken, off = find_stop(lone.log.since(0))
    assert lone.log.rows["time"][off] - lone.log.rows["time"][taken] <= PATIENCE + MS


def test_hosts_that_nobody_has_heard_of_lately_get_no_answers(lone):
    lone.enable()
    assert {type(m) for m, _ in receive(lone.host)} == {ArmState, Done}
    lone.turn(2_000 * MS)
    assert not receive(lone.host)


@pytest.fixture
def served(tmp_path):
    """The folder of a device that a thread keeps in wall time."""
    wire, ended = open_socket(arm_socket_path(tmp_path)), threading.Event()
    device = ArmDevice(Rig(1, pictures=False), wire, MotionLog(context), time.monotonic_ns())

    def work():
        while not ended.is_set():
            wait([wire], 0.001)
            device.step(time.monotonic_ns())

    thread = threading.Thread(target=work)
    thread.start()
    yield tmp_path
    ended.set()
    thread.join(DEADLINE)
    wire.close()


@pytest.mark.alone
def test_a_remote_arm_tells_its_joints_and_is_on_for_the_one_who_enabled_it_alone(served):
    with closing(RemoteArm(served)) as one, closing(RemoteArm(served)) as other:
        assert not one.measure().enabled
        one.request(ArmAction.HOLD_AT_TARGET)
        shown = one.measure().q
        one.request(ArmAction.RETURN_TO_START)
        assert not np.allclose(one.measure().q, shown)
        one.enable()
        other.request(ArmAction.REPORT)
        assert not other.measure().enabled
        assert not other.apply(Command(1, 0, 0, np.ones(3), True)).any()
    assert [path.name for path in served.iterdir()] == ["arm"]


def test_an_arm_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(NoAnswer, match="cannot be reached"):
        RemoteArm(tmp_path)
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- all of it

LAB = Lab(
    simulation={
        "camera": {"frame_rate": 30.0, "width": 320, "height": 240},
        "scene": {"focal": [300.0, 400.0]},
    }
)


def session_of(bench, path, seconds, **choices):
    patient = Thresholds(overrun=1.0, latency=1.0, stale_slow=50.0, stale_hold=50.0, silence=1.0)
    servo = Servo(LAB.mechanism, LAB.tool, **{"gate": LAB.gate, "thresholds": patient} | choices)
    return bench.session(servo, LAB.markers, seconds, path, frames=30)


@pytest.fixture(scope="module")
def bench():
    with SimulatedLab(1, read_rig_settings(LAB)) as bench:
        yield bench


def started(session):
    """A servo process whose loop runs."""
    servo = ServoProcess(session)
    end = time.monotonic() + DEADLINE
    while servo.beats.value < 3:
        assert time.monotonic() < end
        wait([servo.pipe], 0.01)
        while servo.pipe.poll():
            assert isinstance(said := servo.pipe.recv(), Report), said
    return servo


def live(bench, path, seconds, progress=ignore_report, **choices):
    """Record and result of a live run."""
    servo = ServoProcess(session_of(bench, path, seconds, **choices))
    try:
        result = supervise(servo, bench.off, progress)
    finally:
        servo.end()
    assert result.loop is not None, result.cause
    return read_record(path), result


@pytest.mark.alone
@pytest.mark.slow
def test_a_live_run_moves_the_arm_records_every_tick_and_leaves_it_off(bench, tmp_path):
    before, reports, paths = bench.log.last()["q"], [], map(tmp_path.joinpath, "abcdef")

    def attempt():
        reports.clear()
        return live(bench, next(paths), 1.0, reports.append)

    record, result = undisturbed(attempt, lambda run: "FAULT" not in run[0].phase)
    assert record.complete
    assert len(record.time) == result.loop.ticks > 0
    assert result.loop.collections == 0
    assert [report.time for report in reports] == sorted(report.time for report in reports)
    last = bench.log.last()
    assert not last["enabled"]
    assert not np.allclose(last["q"], before)


@pytest.mark.alone
@pytest.mark.slow
def test_an_arm_that_takes_its_time_to_stop_is_not_taken_for_a_servo_that_hangs(bench, tmp_path):
    slow, paths = replace(LAB.gate, slew=(0.1, 0.1, 8.0)), map(tmp_path.joinpath, "abcdef")

    def left(run):
        return np.abs(run[0].ticks["command"][-1] / np.array(slow.slew)).max()

    run = undisturbed(lambda: live(bench, next(paths), 0.8, gate=slow), lambda run: left(run) > 0.0)
    assert run[0].complete and left(run) > 2.0 * MAX_SILENT_POLLS * POLL_NS * 1e-9
    assert not bench.log.last()["enabled"]


@pytest.mark.alone
@pytest.mark.parametrize(
    ("blow", "word"),
    [
        (signal.SIGKILL, "killed (SIGKILL)"),
        pytest.param(signal.SIGSTOP, "stopped", marks=pytest.mark.slow),
    ],
)
def test_a_servo_process_that_is_killed_or_stopped_is_noticed_and_the_arm_stands_still(
    bench, tmp_path, blow, word
):
    servo = started(session_of(bench, tmp_path / "run.mcap", 600.0))
    os.kill(servo.process.pid, blow)
    cause = supervise(servo, bench.off).cause
    assert word in cause
    assert "drive went off" in cause
    assert not servo.process.is_alive()
    last = bench.log.last()
    assert not last["enabled"]
    assert not last["applied"].any()
    assert len(read_record(tmp_path / "run.mcap").time) >= 0
    servo.end()


def test_a_laboratory_that_cannot_be_is_one_sentence_also_from_another_process():
    with pytest.raises(RcmServoError, match="seed must be"), SimulatedLab(-1, RigSettings()):
        pass


def test_a_folder_too_deep_for_sockets_is_refused_before_anything_is_started(tmp_path, monkeypatch):
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(deep))
    with pytest.raises(UnusableFile, match="TMPDIR"), SimulatedLab(1, RigSettings()):
        pass
    assert not list(deep.iterdir())


SCRIPT = """
if __name__ == "__main__":
    import signal
    import sys
    from pathlib import Path

    # also where a script runs the tests in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)
    from rcmservo.live.supervisor import run_live
    from test_live import LAB, Bench, rig_settings, session_of

    try:
        told = lambda report: print("tick", flush=True)
        with Bench(1, rig_settings(LAB)) as bench:
            run_live(session_of(bench, Path({path!r}), 600.0), bench.off, told)
    except KeyboardInterrupt:
        print("stopped", flush=True)
"""


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize("blow", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_ends_a_run_in_order_and_a_supervisor_that_is_killed_leaves_no_process(
    tmp_path, blow
):
    """All processes hold the same standard output: it ends when the last of them does."""
    script, path = tmp_path / "script.py", tmp_path / "run.mcap"
    there = tempfile.mkdtemp()
    script.write_text(SCRIPT.format(path=str(path)))
    with subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        start_new_session=True,
        env=with_tests(TMPDIR=there),
    ) as running:
        try:
            assert running.stdout.readline() == b"tick\n"
            if blow is signal.SIGINT:
                os.killpg(running.pid, blow)
            else:
                os.kill(running.pid, blow)
            said, _ = running.communicate(timeout=DEADLINE)
        except BaseException:
            os.killpg(running.pid, signal.SIGKILL)
            raise
    assert (b"stopped" in said) == (blow is signal.SIGINT)
    assert not os.listdir(there)
    os.rmdir(there)
    assert read_record(path).complete
