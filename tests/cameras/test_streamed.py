"""What all cameras' drivers share, on a camera that does what the test says."""

import re
import threading
from collections.abc import Iterator
from contextlib import closing
from types import SimpleNamespace

import pytest
from numbered import number_in, picture, wait_for

from rcmservo.hardware.cameras import streamed
from rcmservo.hardware.cameras.streamed import CameraLost, Snapshot, StreamedCamera

Says = Snapshot | Exception | None


class Scripted:
    """A stream that gives one thing after the other, and then nothing."""

    def __init__(self, *says: Says) -> None:
        self.says: Iterator[Says] = iter(says)
        self.over, self.closed = threading.Event(), False

    def next(self) -> Snapshot | None:
        said = next(self.says, None)
        if said is None:
            self.over.set()
            threading.Event().wait(0.001)
        if isinstance(said, Exception):
            raise said
        return said

    def close(self) -> None:
        self.closed = True


def shot(number: int, **others: int) -> Snapshot:
    return Snapshot(picture(number), 100 * number, 100 * number + 7, **others)


def run(*streams: Scripted | Exception, lasting: bool = True) -> StreamedCamera:
    """A camera of these connections, one after the other."""
    left = iter(streams)

    def opened() -> Scripted:
        stream = next(left)
        if isinstance(stream, Exception):
            raise stream
        return stream

    camera = StreamedCamera(opened, lasting, again=0.0)
    ends = [stream for stream in streams if isinstance(stream, Scripted)]
    wait_for((ends[-1] if lasting else ends[0]).over.is_set)
    return camera


def test_the_newest_frame_wins_and_is_told_at_once() -> None:
    stream = Scripted(*map(shot, range(5)))
    with closing(run(stream)) as camera:
        frame = camera.latest()
        assert frame is not None and frame is camera.latest()
        assert (frame.number, frame.exposure, frame.arrival) == (4, 400, 407)
        assert number_in(frame.image) == 4
        assert camera.account().frames == 5
    assert stream.closed


def test_frames_that_were_lost_incomplete_or_passed_over_keep_their_numbers() -> None:
    spoilt = Snapshot(None, 0, 0)
    stream = Scripted(shot(0), shot(3, missed=2), spoilt, shot(9, passed=3, spoilt=1))
    with closing(run(stream)) as camera:
        frame, account = camera.latest(), camera.account()
        assert frame is not None and frame.number == 9
        assert (account.frames, account.lost, account.incomplete) == (6, 2, 2)


def test_a_picture_of_another_size_is_dropped_and_told() -> None:
    other = Snapshot(picture(1, 640, 480), 0, 0)
    with closing(run(Scripted(shot(0), other))) as camera:
        frame = camera.latest()
        assert frame is not None and frame.number == 0
        assert camera.account().incomplete == 1
        assert camera.account().trouble == "pictures come of another size than before"


def test_a_camera_none_of_whose_frames_is_whole_is_a_trouble(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It began well, a while ago, and then frames came that were cut short."""
    cut, now = Snapshot(None, 0, 0), [100.0]
    monkeypatch.setattr(streamed, "time", SimpleNamespace(monotonic=lambda: now[0]))

    class Later(Scripted):
        def next(self) -> Snapshot | None:
            now[0] += 1.0
            return super().next()

    with closing(run(Later(shot(0), cut, cut, cut))) as camera:
        assert re.fullmatch(
            r"no whole frame has come for \d+ s: 3 came incomplete", camera.account().trouble
        )
    with closing(run(Later(cut, cut, shot(0), shot(1)))) as camera:
        assert "incomplete" not in camera.account().trouble


def test_a_camera_that_is_lost_is_opened_again_and_its_numbers_go_on() -> None:
    gone = CameraLost("gone")
    first, second = Scripted(shot(0), shot(1), gone), Scripted(shot(2))
    with closing(run(first, CameraLost("still gone"), second)) as camera:
        frame, account = camera.latest(), camera.account()
        assert first.closed and frame is not None and frame.number == 2
        assert (account.reconnects, account.trouble) == (1, "")


def test_one_that_ends_is_not_opened_again() -> None:
    stream = Scripted(shot(0), None, CameraLost("the file has ended"))
    with closing(run(stream, Scripted(shot(1)), lasting=False)) as camera:
        wait_for(lambda: stream.closed)
        assert camera.account().trouble == "the file has ended"
        assert camera.account().reconnects == 0


def test_one_that_cannot_be_opened_says_so_at_once() -> None:
    with pytest.raises(CameraLost, match="nobody there"):
        run(CameraLost("nobody there"))


def test_a_mistake_in_a_driver_is_not_silent() -> None:
    camera = StreamedCamera(lambda: Scripted(shot(0), ZeroDivisionError()))
    with closing(camera), pytest.raises(ZeroDivisionError):
        wait_for(lambda: camera.latest() is None and False)
