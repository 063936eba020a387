"""The wall clock, the real-time context and the tracking thread: what they promise, without
measuring time.
"""

import gc
import os
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from rcmservo.errors import BadInput
from rcmservo.interfaces import Dropped, Frame, Markers, Measured
from rcmservo.live import realtime as module
from rcmservo.live.realtime import realtime, urgent
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import RecordingClock, WallClock, ticks
from rcmservo.loop.plant import Plant

PATIENCE = 20.0


class Stepped:
    """A clock whose waits end `late` ns too late."""

    def __init__(self, late=0):
        self.time, self.late = 0, late

    def now(self):
        return self.time

    def wait_until(self, time):
        self.time = max(time, self.time) + self.late


def test_the_wall_clock_never_ends_a_wait_early():
    clock = WallClock()
    due = clock.now() + 2_000_000
    clock.wait_until(due)
    assert clock.now() >= due
    clock.wait_until(due - 1_000_000_000)


def test_punctuality_notes_how_late_each_wait_ended():
    clock = RecordingClock(Stepped(late=7))
    assert len(list(ticks(clock, 100.0, 0.05))) == 5
    assert list(clock.lateness) == [7] * 5


@pytest.fixture
def frozen_heap():
    """What earlier tests left is not searched for garbage, which takes a second."""
    gc.freeze()
    yield
    gc.unfreeze()


def state_of_the_process():
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval(), policy, len(gc.callbacks)


@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_realtime_leaves_the_process_as_it_found_it_even_after_an_error():
    before = state_of_the_process()
    with pytest.raises(KeyError), realtime():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        raise KeyError
    assert state_of_the_process() == before


@pytest.mark.usefixtures("frozen_heap")
def test_no_collection_happens_in_it_and_one_that_does_is_counted():
    with realtime() as got:
        heap = [[] for _ in range(100_000)]
        for one in heap:
            one.append(one)
        assert got.collections == 0
        gc.collect()
        assert got.collections == 1


@pytest.mark.usefixtures("frozen_heap")
@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_what_the_system_refuses_is_told_in_words_and_everything_else_is_done(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(module, "_system", refuse)
    with realtime() as got:
        assert not gc.isenabled()
    assert len(got.refused) == 2
    assert all("Operation not permitted" in sentence for sentence in got.refused)


@pytest.mark.usefixtures("frozen_heap")
@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_the_loop_goes_first_then_the_threads_there_are_and_then_all_else():
    def policy(thread=0):
        return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(
            thread
        ).sched_priority

    ended, found = threading.Event(), []
    thread = threading.Thread(target=ended.wait, args=(PATIENCE,))
    thread.start()
    try:
        with realtime() as got:
            if got.refused:
                pytest.skip(got.refused[0])
            later = threading.Thread(target=lambda: found.append(policy()))
            later.start()
            later.join(PATIENCE)
            assert policy()[0] == policy(thread.native_id)[0] == os.SCHED_FIFO
            assert policy()[1] > policy(thread.native_id)[1]
            assert found == [(os.SCHED_OTHER, 0)]
        assert policy(thread.native_id) == (os.SCHED_OTHER, 0)
    finally:
        ended.set()
        thread.join(PATIENCE)


@pytest.mark.usefixtures("frozen_heap")
@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_a_thread_that_takes_commands_to_a_device_goes_behind_the_loop_and_before_the_others():
    def priority(thread):
        return os.sched_getparam(thread.native_id).sched_priority

    def work():
        found.append(urgent())
        asked.set()
        ended.wait(PATIENCE)

    asked, ended, found = threading.Event(), threading.Event(), []
    threads = [threading.Thread(target=one) for one in (work, lambda: ended.wait(PATIENCE))]
    for thread in threads:
        thread.start()
    try:
        assert asked.wait(PATIENCE)
        if found != [""]:
            pytest.skip(found[0])
        alone = priority(threads[0])
        with realtime():
            assert os.sched_getparam(0).sched_priority > priority(threads[0]) > priority(threads[1])
        assert priority(threads[0]) == alone > priority(threads[1])
    finally:
        ended.set()
        for thread in threads:
            thread.join(PATIENCE)


@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_urgency_that_is_refused_is_noted_and_no_error(monkeypatch, caplog):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level("INFO"):
        assert "real-time scheduling was refused (Operation not permitted)" in urgent()
    assert "other work may delay what goes to the device" in caplog.text


class Scripted:
    """A camera that gives what it is told to, and a tracker that sees each frame's number."""

    def __init__(self):
        self.frame = None
        self.resets = 0

    def latest(self):
        if isinstance(self.frame, Exception):
            raise self.frame
        return self.frame

    def find(self, frame):
        if frame.image is None:
            raise BadInput("frame.image", None, "a picture")
        return Markers(np.full((2, 2), float(frame.number)), np.ones(2), np.ones(2))

    def reset(self):
        self.resets += 1


PICTURE = np.zeros((4, 4, 3), dtype=np.uint8)


def picture(number, exposure=0):
    return Frame(number, exposure, exposure, image=PICTURE)


def test_the_loop_gets_the_newest_frame_that_is_ready_together_with_its_own_markers():
    eye, clock = Scripted(), Stepped()
    thread = TrackingThread(eye, eye, clock)
    assert thread.latest() is None
    for number in (0, 1, 2):
        eye.frame = picture(number)
        clock.time = 100 + number
        thread.look()
        frame = thread.latest()
        eye.frame = picture(number + 50)
        thread.look()
        assert (frame.number, frame.arrival) == (number, 100 + number)
        assert np.array_equal(thread.find(frame).points, np.full((2, 2), float(number)))
    assert thread.latest().number == 52


def test_a_frame_is_tracked_once_and_stays_the_same_object():
    eye = Scripted()
    thread = TrackingThread(eye, eye, Stepped())
    eye.frame = picture(1)
    thread.look()
    first = thread.latest()
    thread.look()
    assert thread.latest() is first


def test_a_reset_of_the_loop_reaches_the_tracker_before_the_next_frame():
    eye = Scripted()
    thread = TrackingThread(eye, eye, Stepped())
    thread.reset()
    assert eye.resets == 0
    for number in range(3):
        eye.frame = picture(number)
        thread.look()
    assert eye.resets == 1


class Still:
    def enable(self):
        pass

    def measure(self):
        return Measured(0, np.zeros(3), True)

    def apply(self, command):
        return command.rates


def test_a_frame_that_the_tracker_refuses_is_damaged_for_the_plant_and_the_next_one_is_not():
    eye, clock = Scripted(), Stepped()
    clock.time = 10
    thread = TrackingThread(eye, eye, clock)
    plant = Plant(Still(), thread, thread, clock)
    eye.frame = picture(1)
    thread.look()
    assert plant.read().frame == 1
    eye.frame = replace(picture(2, 1), image=None)
    thread.look()
    seen = plant.read()
    assert (seen.frame, seen.dropped) == (1, Dropped.DAMAGED)
    eye.frame = picture(3, 2)
    thread.look()
    seen = plant.read()
    assert (seen.frame, seen.dropped) == (3, Dropped.NONE)


def test_the_thread_never_makes_the_loop_wait_for_a_slow_tracker():
    busy, done = threading.Event(), threading.Event()

    class Slow(Scripted):
        def find(self, frame):
            busy.set()
            assert done.wait(PATIENCE)
            return super().find(frame)

    eye = Slow()
    eye.frame = picture(1)
    with TrackingThread(eye, eye, Stepped()) as thread:
        assert busy.wait(PATIENCE)
        assert thread.latest() is None
        done.set()


def test_a_tracker_that_takes_long_for_its_first_frame_is_waited_for_and_a_silent_camera_is_not():
    """The clock goes on once the tracker is at work, which ends half a minute later."""
    at_work, later = threading.Event(), threading.Event()

    class Going(Stepped):
        def wait_until(self, time):
            assert at_work.wait(PATIENCE)
            super().wait_until(time)
            if self.time >= 30 * 10**9:
                later.set()

    class Compiled(Scripted):
        def find(self, frame):
            at_work.set()
            assert later.wait(PATIENCE)
            return super().find(frame)

    eye = Compiled()
    eye.frame = picture(1)
    with TrackingThread(eye, eye, Going()) as thread:
        thread.wait_for(frames=1, patience=3.0)
        assert thread.latest().number == 1
    silent = Scripted()
    with TrackingThread(silent, silent, Stepped()) as thread:
        thread.wait_for(frames=1, patience=3.0)
        assert thread.latest() is None


class Breaking(Scripted):
    """A camera that gives so many frames and then fails."""

    def __init__(self, frames):
        super().__init__()
        self.frames = frames

    def latest(self):
        if not self.frames:
            raise RuntimeError("cable")
        return self.frames.pop(0)


def over(thread):
    """Wait until the thread has ended by itself."""
    thread._thread.join(PATIENCE)
    assert not thread._thread.is_alive()


def test_an_error_after_the_first_frame_stops_the_frames_and_is_raised_at_the_end():
    eye = Breaking([picture(1)])
    with pytest.raises(RuntimeError, match="cable"), TrackingThread(eye, eye, Stepped()) as thread:
        over(thread)
        assert thread.latest().number == thread.latest().number == 1


def test_an_error_before_the_first_frame_is_raised_at_once():
    eye = Breaking([])
    with pytest.raises(RuntimeError, match="cable"), TrackingThread(eye, eye, Stepped()) as thread:
        over(thread)
        thread.latest()
        raise AssertionError("latest has not raised")


def test_a_camera_or_tracker_that_answers_something_else_is_named_by_the_thread():
    eye = Scripted()
    eye.frame = [picture(1)]
    with pytest.raises(BadInput, match=r"Scripted\.latest\(\) must be a Frame"):
        TrackingThread(eye, eye, Stepped()).look()
    eye.frame, eye.find = picture(1), lambda frame: None
    with pytest.raises(BadInput, match=r"Scripted\.find\(\) must be Markers"):
        TrackingThread(eye, eye, Stepped()).look()
