"""What the servo process tells of a run: when the drive is on, and why the markers were never
seen. Run here in the tests' own process, with a wall for a picture.
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
from rcmservo.tracking import ColourMarkers

Q = np.array([0.6, 0.2, 120.0])


class StillArm:
    """An arm that is never asked to move; it notes the heartbeat while its drive comes on."""

    def __init__(self, beats: Any, noted: list[int]) -> None:
        self.beats, self.noted, self.enabled = beats, noted, False

    def enable(self) -> None:
        self.noted.append(self.beats.value)
        self.enabled = True

    def measure(self) -> rs.Measured:
        return rs.Measured(time.monotonic_ns(), Q, self.enabled)

    def apply(self, command: rs.Command) -> Any:
        assert not command.rates.any()
        self.enabled = self.enabled and command.enabled
        return np.zeros(3)


class Wall:
    """Thirty pictures a second of nothing but grey."""

    def __init__(self) -> None:
        self.frame: rs.Frame | None = None

    def latest(self) -> rs.Frame | None:
        now = time.monotonic_ns()
        if self.frame is None or now - self.frame.exposure > 33_000_000:
            number = 0 if self.frame is None else self.frame.number + 1
            image = np.full((240, 320, 3), 90, np.uint8)
            self.frame = rs.Frame(number, now, now, image=image)
        return self.frame


def shown(plant: Plant) -> rs.Target:
    """A target from another day."""
    del plant
    return rs.Target(np.array([[100.0, 100.0], [120.0, 150.0]]), Q)


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Any]:
    """Runs a session of 1.2 s with this arm; what it sent last."""
    ours, theirs = Pipe()
    patient = rs.Thresholds(overrun=1.0, latency=1.0, stale_slow=50.0, stale_hold=50.0, silence=1.0)
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0), thresholds=patient)

    def run(beats: Any, noted: list[int]) -> Any:
        session = Session(
            servo,
            1.2,
            arm=partial(StillArm, beats, noted),
            camera=Wall,
            tracker=ColourMarkers,
            recorder=partial(Recorder, tmp_path / "run.mcap", {}),
            target=shown,
        )
        servo_process.serve(session, beats, theirs)
        while ours.poll():
            said = ours.recv()
        return said

    usual = {one: signal.getsignal(one) for one in (signal.SIGINT, *END_SIGNALS)}
    yield run
    for one, handler in usual.items():
        signal.signal(one, handler)


@pytest.mark.alone
def test_a_live_run_that_never_saw_the_markers_says_why(serve: Any, tmp_path: Path) -> None:
    """And from when the drive comes on, its heartbeat does not say that nothing has begun."""
    beats, noted = RawValue("q", 7), list[int]()
    result = serve(beats, noted)
    assert not result.settled
    assert "the picture is grey" in result.cause
    assert noted == [ENABLING] and beats.value == IDLE
    assert len(read_record(tmp_path / "run.mcap").time) == result.loop.ticks > 0


def test_what_a_servo_process_cannot_use_is_said_in_the_supervisor(
    serve: Any, tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").write_text("something else")
    beats, noted, (ours, theirs) = RawValue("q", 7), list[int](), Pipe()
    theirs.send(serve(beats, noted))
    assert not noted and beats.value == IDLE
    with pytest.raises(RcmServoError, match=r"run\.mcap"):
        supervise(SimpleNamespace(wire=ours, beats=beats), rely_on_watchdog)  # type: ignore


@pytest.mark.parametrize(("beat", "hangs"), [(IDLE, False), (ENABLING, False), (0, True)])
def test_only_a_heart_that_has_begun_to_beat_can_stand_still(
    beat: int, hangs: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive may take its time to come on."""

    class Process:
        exitcode = None

    class Servo:
        process, beats = Process(), RawValue("q", beat)

    clock = iter(range(0, 10**12, 10**9))
    monkeypatch.setattr(time, "monotonic_ns", lambda: next(clock))
    watchman = HeartbeatMonitor(Servo())  # pyright: ignore[reportArgumentType]
    assert any(watchman.has_failed() for _ in range(MAX_SILENT_POLLS + 2)) == hangs
