"""Common part of all camera drivers, on a scripted camera."""

import re
import threading
from collections.abc import Iterator
from contextlib import closing
from types import SimpleNamespace

import pytest
from numbered_camera import numbered_image, read_number, wait_for

from rcmservo.hardware.cameras import streamed_camera
from rcmservo.hardware.cameras.streamed_camera import CameraLost, Snapshot, StreamedCamera

Event = Snapshot | Exception | None


class Scripted:
    """Stream that returns or raises some events in turn, and then returns None."""

    def __init__(self, *events: Event) -> None:
        self.events: Iterator[Event] = iter(events)
        self.exhausted, self.closed = threading.Event(), False

    def read(self) -> Snapshot | None:
        event = next(self.events, None)
        if event is None:
            self.exhausted.set()
            threading.Event().wait(0.001)
        if isinstance(event, Exception):
            raise event
        return event

    def close(self) -> None:
        self.closed = True


def snapshot_of(number: int, **others: int) -> Snapshot:
    return Snapshot(numbered_image(number), 100 * number, 100 * number + 7, **others)


def run(*streams: Scripted | Exception, reopens: bool = True) -> StreamedCamera:
    """Open a camera with some connections in turn."""
    remaining = iter(streams)

    def open_stream() -> Scripted:
        stream = next(remaining)
        if isinstance(stream, Exception):
            raise stream
        return stream

    camera = StreamedCamera(open_stream, reopens, reopen_period=0.0)
    ends = [stream for stream in streams if isinstance(stream, Scripted)]
    wait_for((ends[-1] if reopens else ends[0]).exhausted.is_set)
    return camera


def test_the_newest_frame_is_returned_at_once() -> None:
    stream = Scripted(*map(snapshot_of, range(5)))
    with closing(run(stream)) as camera:
        frame = camera.latest()
        assert frame is not None and frame is camera.latest()
        assert (frame.number, frame.exposure, frame.arrival) == (4, 400, 407)
        assert read_number(frame.image) == 4
        assert camera.counts().frames == 5
    assert stream.closed


def test_lost_incomplete_and_skipped_frames_keep_their_numbers() -> None:
    damaged = Snapshot(None, 0, 0)
    stream = Scripted(
        snapshot_of(0), snapshot_of(3, lost=2), damaged, snapshot_of(9, skipped=3, incomplete=1)
    )
    with closing(run(stream)) as camera:
        frame, account = camera.latest(), camera.counts()
        assert frame is not None and frame.number == 9
        assert (account.frames, account.lost, account.incomplete) == (6, 2, 2)


def test_an_image_of_another_size_is_dropped_and_reported() -> None:
    other = Snapshot(numbered_image(1, 640, 480), 0, 0)
    with closing(run(Scripted(snapshot_of(0), other))) as camera:
        frame = camera.latest()
        assert frame is not None and frame.number == 0
        assert camera.counts().incomplete == 1
        assert camera.counts().trouble == "images have another size than before"


def test_a_camera_without_complete_frames_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its first frame was complete, and the later ones are truncated."""
    truncated, now = Snapshot(None, 0, 0), [100.0]
    monkeypatch.setattr(streamed_camera, "time", SimpleNamespace(monotonic=lambda: now[0]))

    class SlowStream(Scripted):
        def read(self) -> Snapshot | None:
            now[0] += 1.0
            return super().read()

    with closing(run(SlowStream(snapshot_of(0), truncated, truncated, truncated))) as camera:
        assert re.fullmatch(
            r"no complete frame has come for \d+ s: 3 came incomplete", camera.counts().trouble
        )
    with closing(run(SlowStream(truncated, truncated, snapshot_of(0), snapshot_of(1)))) as camera:
        assert "incomplete" not in camera.counts().trouble


def test_a_lost_camera_is_reopened_and_its_numbers_continue() -> None:
    gone = CameraLost("gone")
    first, second = Scripted(snapshot_of(0), snapshot_of(1), gone), Scripted(snapshot_of(2))
    with closing(run(first, CameraLost("still gone"), second)) as camera:
        frame, account = camera.latest(), camera.counts()
        assert first.closed and frame is not None and frame.number == 2
        assert (account.reconnects, account.trouble) == (1, "")


def test_a_file_that_has_ended_is_not_reopened() -> None:
    stream = Scripted(snapshot_of(0), None, CameraLost("the file has ended"))
    with closing(run(stream, Scripted(snapshot_of(1)), reopens=False)) as camera:
        wait_for(lambda: stream.closed)
        assert camera.counts().trouble == "the file has ended"
        assert camera.counts().reconnects == 0


def test_a_camera_that_cannot_be_opened_is_reported_at_once() -> None:
    with pytest.raises(CameraLost, match="no camera"):
        run(CameraLost("no camera"))


def test_an_unexpected_error_in_a_driver_is_raised() -> None:
    camera = StreamedCamera(lambda: Scripted(snapshot_of(0), ZeroDivisionError()))
    with closing(camera), pytest.raises(ZeroDivisionError):
        wait_for(lambda: camera.latest() is None and False)
