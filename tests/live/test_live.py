"""Live loop: datagrams and frames between processes, the remote arm, and the supervisor."""

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

from conftest import make_environment
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import BadInput, RcmServoError, UnusableFile
from rcmservo.hardware.device_kinds import prepare_tracker
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
from rcmservo.safety.watchdog import WATCHDOG_TIMEOUT_NS
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings
from rcmservo.sim.processes.arm_process import ArmDevice
from rcmservo.sim.processes.camera_process import LoggedArm
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.processes.motion_log import MotionLog, find_stop
from rcmservo.sim.rig_file import read_rig_settings
from stalls import retry_after_stalls

MS = 1_000_000
TEST_TIMEOUT_S = 300.0
"""Time-out of a test in s."""

integers = st.integers(-(2**63), 2**63 - 1)
sessions = st.integers(0, 2**64 - 1)
triples = st.lists(st.floats(), min_size=3, max_size=3).map(np.array)
messages = st.one_of(
    st.builds(
        SessionCommand,
        sessions,
        st.builds(Command, integers, integers, integers, triples, st.booleans()),
    ),
    st.builds(ArmRequest, integers, sessions, st.sampled_from(ArmAction)),
    st.builds(ArmState, sessions, integers, triples, st.booleans(), triples, integers),
    st.builds(Done, integers),
)


@given(messages)
def test_a_decoded_message_equals_the_encoded_one_bit_for_bit(message):
    out = decode(encode(message))
    assert type(out) is type(message)
    assert encode(out) == encode(message)


@given(messages, st.data())
def test_a_truncated_extended_or_damaged_datagram_is_no_message(message, data):
    sent = encode(message)
    assert decode(sent[: data.draw(st.integers(0, len(sent) - 1))]) is None
    assert decode(sent + data.draw(st.binary(min_size=1, max_size=8))) is None
    bit = data.draw(st.integers(0, 8 * len(sent) - 1))
    flipped = bytearray(sent)
    flipped[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(flipped)) is None


@given(st.binary(max_size=200), st.integers(0, 255))
def test_noise_is_no_message_even_with_a_valid_checksum(noise, kind):
    assert decode(noise) is None
    summed = MARK + bytes([kind]) + noise
    out = decode(summed + zlib.crc32(summed).to_bytes(4, "little"))
    assert out is None or encode(out) == summed + zlib.crc32(summed).to_bytes(4, "little")


context = get_context("spawn")


def picture(number, grey=0, size=(4, 6, 3)):
    return Frame(number, number, number + 1, image=np.full(size, grey, dtype=np.uint8))


def test_the_newest_frame_of_the_ring_equals_the_published_one_and_stays_one_object():
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


def test_a_frame_being_overwritten_is_not_used_and_a_damaged_one_has_no_image():
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


def test_the_ring_refuses_an_image_of_another_shape():
    ring = FrameRing(context, 6, 4)
    for frame in (picture(1, size=(6, 4, 3)), Frame(1, 1, 1)):
        with pytest.raises(BadInput):
            ring.publish(frame)
    with pytest.raises(BadInput):
        FrameRing(context, 0, 4)


class ManualArm:
    """Arm device whose clock the test controls, and a host's socket to it."""

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

    def step(self, wait=0):
        self.now += wait
        self.device.step(self.now)

    def send(self, message, wait=0):
        self.host.send(message if isinstance(message, bytes) else encode(message))
        self.step(wait)

    def enable(self, session=7):
        self.send(ArmRequest(self.now, session, ArmAction.ENABLE))

    def command(self, number, rates=(0.1, 0.0, 0.0), session=7, enabled=True):
        return SessionCommand(
            session,
            Command(number, self.now, self.now + WATCHDOG_TIMEOUT_NS, np.array(rates), enabled),
        )

    @property
    def applied_rates(self):
        """Rates that the arm applies."""
        return self.device.arm.watchdog.rates.tolist()

    @property
    def is_on(self):
        return self.device.arm.watchdog.enabled


@pytest.fixture
def manual_arm(tmp_path):
    with closing(ManualArm(tmp_path)) as manual_arm:
        yield manual_arm


def test_the_arm_follows_valid_commands_of_the_session_that_enabled_it(manual_arm):
    before = manual_arm.device.arm.q_true
    manual_arm.enable()
    for k in range(20):
        manual_arm.send(manual_arm.command(k, (0.2, 0.0, -10.0)), 10 * MS)
    moved = manual_arm.device.arm.q_true - before
    assert manual_arm.is_on
    assert moved[0] > 0.01
    assert moved[2] < -0.5
    manual_arm.step(WATCHDOG_TIMEOUT_NS + 2 * MS)
    assert not manual_arm.is_on
    assert not manual_arm.log.last()["applied"].any()


noise_datagrams = st.lists(
    st.one_of(
        st.binary(max_size=100),
        messages.filter(
            lambda m: not (isinstance(m, SessionCommand) and not m.command.enabled)
        ).map(encode),
    ),
    max_size=6,
)


@pytest.fixture(scope="module")
def shared_arm(tmp_path_factory):
    with closing(ManualArm(tmp_path_factory.mktemp("arm"))) as manual_arm:
        yield manual_arm


@given(noise=st.lists(noise_datagrams, min_size=5, max_size=5), start=st.integers(0, 3))
def test_the_drive_is_off_one_time_out_after_the_last_valid_command_despite_noise(
    shared_arm, noise, start
):
    shared_arm.step(MS)
    shared_arm.enable()
    command = encode(shared_arm.command(start))
    shared_arm.send(command)
    assert shared_arm.is_on
    for burst in noise:
        for datagram in (*burst, command, command[:-1]):
            shared_arm.send(datagram)
        shared_arm.step(WATCHDOG_TIMEOUT_NS // 5 + MS)
    assert not shared_arm.is_on
    assert not any(shared_arm.applied_rates)


def test_a_repeated_request_datagram_is_not_executed_again(manual_arm):
    request = encode(ArmRequest(manual_arm.now, 7, ArmAction.ENABLE))
    manual_arm.send(request)
    assert manual_arm.is_on
    manual_arm.step(WATCHDOG_TIMEOUT_NS + 2 * MS)
    assert not manual_arm.is_on
    manual_arm.send(request)
    assert not manual_arm.is_on
    manual_arm.send(ArmRequest(manual_arm.now + 1, 7, ArmAction.ENABLE))
    manual_arm.send(ArmRequest(manual_arm.now - 2_000 * MS, 7, ArmAction.ENABLE))
    assert not manual_arm.is_on
    manual_arm.send(ArmRequest(manual_arm.now, 7, ArmAction.ENABLE))
    assert manual_arm.is_on


def test_a_servo_of_an_earlier_session_can_stop_the_arm_but_not_move_it(manual_arm):
    manual_arm.enable(session=1)
    manual_arm.send(manual_arm.command(50, session=1))
    manual_arm.step(WATCHDOG_TIMEOUT_NS * 2)
    manual_arm.enable(session=2)
    manual_arm.send(manual_arm.command(51, (1.0, 1.0, 10.0), session=1))
    assert manual_arm.is_on
    assert not any(manual_arm.applied_rates)
    manual_arm.send(manual_arm.command(0, (0.1, 0.0, 0.0), session=2))
    assert manual_arm.applied_rates == [0.1, 0.0, 0.0]
    manual_arm.send(manual_arm.command(52, session=1, enabled=False))
    assert not manual_arm.is_on


def test_a_session_that_takes_over_a_moving_arm_stops_it_first(manual_arm):
    manual_arm.enable(session=1)
    for k in range(5):
        manual_arm.send(manual_arm.command(k, (0.5, 0.0, 0.0), session=1), 10 * MS)
    manual_arm.enable(session=2)
    manual_arm.step(20 * MS)
    rows = manual_arm.log.since(manual_arm.log.count - 5)
    assert np.ptp(rows["q"], axis=0).max() < 1e-3
    assert manual_arm.is_on


def test_a_stall_of_the_emulator_does_not_stop_the_arm(manual_arm):
    manual_arm.enable()
    for k in range(8):
        manual_arm.host.send(encode(manual_arm.command(k)))
        manual_arm.now += 10 * MS
    manual_arm.step()
    assert manual_arm.is_on
    assert manual_arm.log.rows["time"][manual_arm.log.count - 1] >= manual_arm.now


def test_the_motion_log_holds_the_past_joints(manual_arm):
    manual_arm.enable()
    for k in range(10):
        manual_arm.send(manual_arm.command(k, (0.5, 0.0, 0.0)), 10 * MS)
    rows, camera_side = manual_arm.log.since(0), LoggedArm(manual_arm.log)
    for i in (5, 60, len(rows) - 2):
        halfway = (rows["q"][i] + rows["q"][i + 1]) / 2.0
        assert np.allclose(
            camera_side.joints_at(int(rows["time"][i]) + MS // 2), halfway, atol=1e-12
        )
    assert np.array_equal(camera_side.joints_at(int(rows["time"][-1]) + 9 * MS), rows["q"][-1])
    assert np.array_equal(camera_side.joints_at(0), rows["q"][0])
    assert find_stop(rows) is None
    manual_arm.step(WATCHDOG_TIMEOUT_NS + 5 * MS)
    taken, off = find_stop(manual_arm.log.since(0))
    assert (
        manual_arm.log.rows["time"][off] - manual_arm.log.rows["time"][taken]
        <= WATCHDOG_TIMEOUT_NS + MS
    )


def test_silent_hosts_receive_no_answers(manual_arm):
    manual_arm.enable()
    assert {type(m) for m, _ in receive(manual_arm.host)} == {ArmState, Done}
    manual_arm.step(2_000 * MS)
    assert not receive(manual_arm.host)


@pytest.fixture
def served(tmp_path):
    """Run a device in wall time in a thread and yield its folder."""
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
    thread.join(TEST_TIMEOUT_S)
    wire.close()


@pytest.mark.alone
def test_a_remote_arm_reports_its_joints_and_is_enabled_for_one_session_only(served):
    with closing(RemoteArm(served)) as one, closing(RemoteArm(served)) as other:
        assert not one.measure().enabled
        one.request(ArmAction.HOLD_AT_TARGET)
        at_target = one.measure().q
        one.request(ArmAction.RETURN_TO_START)
        assert not np.allclose(one.measure().q, at_target)
        one.enable()
        other.request(ArmAction.REPORT)
        assert not other.measure().enabled
        assert not other.apply(Command(1, 0, 0, np.ones(3), True)).any()
    assert [path.name for path in served.iterdir()] == ["arm"]


def test_a_missing_arm_gives_one_sentence(tmp_path):
    with pytest.raises(NoAnswer, match="cannot be reached"):
        RemoteArm(tmp_path)
    assert not list(tmp_path.iterdir())


LAB = RigDescription(
    simulation={
        "camera": {"frame_rate": 30.0, "width": 320, "height": 240},
        "scene": {"focal": [300.0, 400.0]},
    }
)


def session_of(bench, path, seconds, **choices):
    tolerant = Thresholds(
        max_tick_delay=1.0,
        max_latency=1.0,
        max_frame_age_slow=50.0,
        max_frame_age_hold=50.0,
        arm_timeout=1.0,
    )
    servo = Servo(LAB.mechanism, LAB.tool, **{"gate": LAB.gate, "thresholds": tolerant} | choices)
    return bench.session(servo, prepare_tracker(LAB), seconds, path, frames=30)


@pytest.fixture(scope="module")
def bench():
    with SimulatedLab(1, read_rig_settings(LAB)) as bench:
        yield bench


def start_servo(session):
    """Start a servo process and wait until its loop runs."""
    servo = ServoProcess(session)
    end = time.monotonic() + TEST_TIMEOUT_S
    while servo.heartbeat.value < 3:
        assert time.monotonic() < end
        wait([servo.pipe], 0.01)
        while servo.pipe.poll():
            assert isinstance(message := servo.pipe.recv(), Report), message
    return servo


def live(bench, path, seconds, progress=ignore_report, **choices):
    """Return the record and the result of a live run."""
    servo = ServoProcess(session_of(bench, path, seconds, **choices))
    try:
        result = supervise(servo, bench.switch_off, progress)
    finally:
        servo.end()
    assert result.loop is not None, result.cause
    return read_record(path), result


@pytest.mark.alone
@pytest.mark.slow
def test_a_live_run_records_every_tick_and_its_slow_stop_is_not_mistaken_for_a_hanging_servo(
    bench, tmp_path
):
    before, reports, paths = bench.log.last()["q"], [], map(tmp_path.joinpath, "abcdef")
    slow = replace(LAB.gate, slew=(0.1, 0.1, 8.0))

    def attempt():
        reports.clear()
        return live(bench, next(paths), 0.8, reports.append, gate=slow)

    def final_speed(record):
        return np.abs(record.ticks["command"][-1] / np.array(slow.slew)).max()

    record, result = retry_after_stalls(
        attempt, lambda run: "FAULT" not in run[0].phase and final_speed(run[0]) > 0.0
    )
    assert record.complete and "FAULT" not in record.phase
    assert len(record.time) == result.loop.ticks > 0
    assert result.loop.collections == 0
    assert [report.time for report in reports] == sorted(report.time for report in reports)
    assert final_speed(record) > 2.0 * MAX_SILENT_POLLS * POLL_NS * 1e-9
    last = bench.log.last()
    assert not last["enabled"]
    assert not np.allclose(last["q"], before)


@pytest.mark.parametrize(
    ("signal_number", "word"),
    [
        (signal.SIGKILL, "killed (SIGKILL)"),
        pytest.param(signal.SIGSTOP, "stopped", marks=pytest.mark.slow),
    ],
)
def test_a_killed_or_suspended_servo_process_is_detected_and_the_arm_stops(
    bench, tmp_path, signal_number, word
):
    servo = start_servo(session_of(bench, tmp_path / "run.mcap", 600.0))
    os.kill(servo.process.pid, signal_number)
    cause = supervise(servo, bench.switch_off).cause
    assert word in cause
    assert "drive went off" in cause
    assert not servo.process.is_alive()
    last = bench.log.last()
    assert not last["enabled"]
    assert not last["applied"].any()
    assert len(read_record(tmp_path / "run.mcap").time) >= 0
    servo.end()


def test_an_invalid_lab_gives_one_sentence_also_from_another_process():
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

    # a script in the background starts with Ctrl-C ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    from rcmservo.live.supervisor import run_live
    from test_live import LAB, SimulatedLab, read_rig_settings, session_of

    try:
        progress = lambda report: print("tick", flush=True)
        with SimulatedLab(1, read_rig_settings(LAB)) as bench:
            run_live(session_of(bench, Path({path!r}), 600.0), bench.switch_off, progress)
    except KeyboardInterrupt:
        print("stopped", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_ends_a_run_in_order_and_a_killed_supervisor_leaves_no_process(
    tmp_path, signal_number
):
    """All processes hold the same standard output, which ends with the last of them."""
    script, path = tmp_path / "script.py", tmp_path / "run.mcap"
    there = tempfile.mkdtemp()
    script.write_text(SCRIPT.format(path=str(path)))
    with subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        start_new_session=True,
        env=make_environment(TMPDIR=there),
    ) as running:
        try:
            assert running.stdout.readline() == b"tick\n"
            if signal_number is signal.SIGINT:
                os.killpg(running.pid, signal_number)
            else:
                os.kill(running.pid, signal_number)
            output, _ = running.communicate(timeout=TEST_TIMEOUT_S)
        except BaseException:
            os.killpg(running.pid, signal.SIGKILL)
            raise
    assert (b"stopped" in output) == (signal_number is signal.SIGINT)
    assert not os.listdir(there)
    os.rmdir(there)
    assert read_record(path).complete
