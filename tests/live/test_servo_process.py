"""Results of the servo process: time of enabling, and the reason for undetected markers.

The process function runs in the test process, with a grey wall in front of the camera.
"""

import signal
import time
from collections.abc import Iterator
from functools import partial
from multiprocessing import Pipe, RawValue
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.errors import RcmServoError
from rcmservo.live import servo_process
from rcmservo.live.servo_process import ENABLING, IDLE, Session
from rcmservo.live.stop_signals import END_SIGNALS
from rcmservo.live.supervisor import MAX_SILENT_POLLS, HeartbeatMonitor, rely_on_watchdog, supervise
from rcmservo.loop.plant import Plant
from rcmservo.recording.reader import read_record
from rcmservo.recording.writer import Recorder
from rcmservo.rig.lazy_rig import LazyRig
from rcmservo.tracking import ColourMarkers

Q = np.array([0.6, 0.2, 120.0])


class StillArm:
    """Arm that is never moved and stores the heartbeat while its drive is enabled."""

    def __init__(self, beats: Any, heartbeats: list[int]) -> None:
        self.beats, self.heartbeats, self.enabled = beats, heartbeats, False

    def enable(self) -> None:
        self.heartbeats.append(self.beats.value)
        self.enabled = True

    def measure(self) -> rs.ArmMeasurement:
        return rs.ArmMeasurement(time.monotonic_ns(), Q, self.enabled)

    def apply(self, command: rs.Command) -> Any:
        assert not command.rates.any()
        self.enabled = self.enabled and command.enabled
        return np.zeros(3)


class Wall:
    """Camera with thirty grey images per second."""

    def __init__(self) -> None:
        self.frame: rs.Frame | None = None

    def latest(self) -> rs.Frame | None:
        now = time.monotonic_ns()
        if self.frame is None or now - self.frame.exposure > 33_000_000:
            number = 0 if self.frame is None else self.frame.number + 1
            image = np.full((240, 320, 3), 90, np.uint8)
            self.frame = rs.Frame(number, now, now, image=image)
        return self.frame


def fixed_target(plant: Plant) -> rs.Target:
    """Return a fixed target."""
    del plant
    return rs.Target(np.array([[100.0, 100.0], [120.0, 150.0]]), Q)


@pytest.fixture
def signal_handlers() -> Iterator[None]:
    """Restore the handlers of the signals that a servo process handles."""
    numbers = signal.SIGINT, *END_SIGNALS
    former_handlers = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in former_handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def run_session(tmp_path: Path, signal_handlers: None) -> Any:
    """Run a session of 1.2 s with this arm and return the last message."""
    here, there = Pipe()
    tolerant = rs.Thresholds(
        max_tick_delay=1.0,
        max_latency=1.0,
        max_frame_age_slow=50.0,
        max_frame_age_hold=50.0,
        arm_timeout=1.0,
    )
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0), thresholds=tolerant)

    def run(beats: Any, heartbeats: list[int]) -> Any:
        session = Session(
            servo,
            1.2,
            LazyRig(
                partial(StillArm, beats, heartbeats),
                Wall,
                ColourMarkers,
                servo.mechanism,
                servo.tool,
            ),
            recorder=partial(Recorder, tmp_path / "run.mcap", {}),
            target=fixed_target,
        )
        servo_process.run_session(session, beats, there)
        while here.poll():
            message = here.recv()
        return message

    return run


@pytest.mark.alone
def test_a_live_run_that_never_detects_the_markers_reports_the_reason(
    run_session: Any, tmp_path: Path
) -> None:
    """The heartbeat also shows from the start that the drive is being enabled."""
    beats, heartbeats = RawValue("q", 7), list[int]()
    result = run_session(beats, heartbeats)
    assert not result.settled
    assert "the picture is grey" in result.cause
    assert heartbeats == [ENABLING] and beats.value == IDLE
    assert len(read_record(tmp_path / "run.mcap").time) == result.loop.ticks > 0


def test_an_error_of_the_servo_process_is_raised_in_the_supervisor(
    run_session: Any, tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").write_text("something else")
    beats, heartbeats, (here, there) = RawValue("q", 7), list[int](), Pipe()
    there.send(run_session(beats, heartbeats))
    assert not heartbeats and beats.value == IDLE
    with pytest.raises(RcmServoError, match=r"run\.mcap"):
        supervise(SimpleNamespace(pipe=here, heartbeat=beats), rely_on_watchdog)  # type: ignore


@pytest.mark.parametrize(("beat", "hangs"), [(IDLE, False), (ENABLING, False), (0, True)])
def test_only_a_heartbeat_that_has_started_can_stop(
    beat: int, hangs: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Enabling a drive may take time."""

    class Process:
        exitcode = None

    class Servo:
        process, heartbeat = Process(), RawValue("q", beat)

    clock = iter(range(0, 10**12, 10**9))
    monkeypatch.setattr(time, "monotonic_ns", lambda: next(clock))
    monitor = HeartbeatMonitor(Servo())  # pyright: ignore[reportArgumentType]
    assert any(monitor.has_failed() for _ in range(MAX_SILENT_POLLS + 2)) == hangs


def test_a_tracker_that_cannot_be_made_is_reported_before_anything_is_connected(
    signal_handlers: None,
) -> None:
    def fail() -> Any:
        raise RcmServoError("no weights")

    connected: list[str] = []
    session = Session(
        rs.Servo(),
        1.0,
        LazyRig(
            partial(connected.append, "arm"),  # type: ignore[arg-type]
            partial(connected.append, "camera"),  # type: ignore[arg-type]
            fail,
            rs.SphericalRcm(),
            rs.RigidTool(30.0),
        ),
        recorder=fail,
    )
    here, there = Pipe()
    servo_process.run_session(session, RawValue("q", 0), there)
    assert str(here.recv()) == "no weights" and not connected
