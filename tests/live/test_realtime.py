"""Wall clock, real-time context and tracking thread, without measurements of time."""

import gc
import os
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from rcmservo.errors import BadInput
from rcmservo.interfaces import ArmMeasurement, DropReason, Frame, Markers
from rcmservo.live import realtime as module
from rcmservo.live.realtime import apply_realtime_settings, request_urgent_priority
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import RecordingClock, WallClock, ticks
from rcmservo.loop.plant import Plant

WAIT_TIMEOUT_S = 20.0


class SteppedClock:
    """Clock whose waits end `late` ns too late."""

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


def test_the_recording_clock_stores_the_lateness_of_each_wait():
    clock = RecordingClock(SteppedClock(late=7))
    assert len(list(ticks(clock, 100.0, 0.05))) == 5
    assert list(clock.lateness) == [7] * 5


@pytest.fixture
def frozen_heap():
    """Exclude objects of earlier tests from garbage collection, which takes a second."""
    gc.freeze()
    yield
    gc.unfreeze()


def state_of_the_process():
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval(), policy, len(gc.callbacks)


@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_realtime_restores_the_process_even_after_an_error():
    gc.unfreeze()  # conftest.py has excluded the modules
    before = state_of_the_process()
    with pytest.raises(KeyError), apply_realtime_settings():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        raise KeyError
    assert state_of_the_process() == before


@pytest.mark.usefixtures("frozen_heap")
def test_garbage_collection_is_off_inside_and_a_forced_one_is_counted():
    with apply_realtime_settings() as results:
        heap = [[] for _ in range(100_000)]
        for cycle in heap:
            cycle.append(cycle)
        assert results.collections == 0
        gc.collect()
        assert results.collections == 1


@pytest.mark.usefixtures("frozen_heap")
@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_refused_requests_are_reported_and_the_others_take_effect(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(module, "_load_c_library", refuse)
    with apply_realtime_settings() as results:
        assert not gc.isenabled()
    assert len(results.refused) == 2
    assert all("Operation not permitted" in sentence for sentence in results.refused)


@pytest.mark.usefixtures("frozen_heap")
@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_the_loop_has_the_first_priority_and_existing_threads_the_next():
    def policy(thread=0):
        return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(
            thread
        ).sched_priority

    ended, policies = threading.Event(), []
    thread = threading.Thread(target=ended.wait, args=(WAIT_TIMEOUT_S,))
    thread.start()
    try:
        with apply_realtime_settings() as results:
            if results.refused:
                pytest.skip(results.refused[0])
            later = threading.Thread(target=lambda: policies.append(policy()))
            later.start()
            later.join(WAIT_TIMEOUT_S)
            assert policy()[0] == policy(thread.native_id)[0] == os.SCHED_FIFO
            assert policy()[1] > policy(thread.native_id)[1]
            assert policies == [(os.SCHED_OTHER, 0)]
        assert policy(thread.native_id) == (os.SCHED_OTHER, 0)
    finally:
        ended.set()
        thread.join(WAIT_TIMEOUT_S)


@pytest.mark.usefixtures("frozen_heap")
@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_a_thread_that_sends_commands_has_a_priority_between_loop_and_other_threads():
    def priority(thread):
        return os.sched_getparam(thread.native_id).sched_priority

    def work():
        refusals.append(request_urgent_priority())
        requested.set()
        ended.wait(WAIT_TIMEOUT_S)

    requested, ended, refusals = threading.Event(), threading.Event(), []
    threads = [
        threading.Thread(target=target) for target in (work, lambda: ended.wait(WAIT_TIMEOUT_S))
    ]
    for thread in threads:
        thread.start()
    try:
        assert requested.wait(WAIT_TIMEOUT_S)
        if refusals != [""]:
            pytest.skip(refusals[0])
        outside = priority(threads[0])
        with apply_realtime_settings():
            assert os.sched_getparam(0).sched_priority > priority(threads[0]) > priority(threads[1])
        assert priority(threads[0]) == outside > priority(threads[1])
    finally:
        ended.set()
        for thread in threads:
            thread.join(WAIT_TIMEOUT_S)


@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="no real-time scheduling here")
def test_a_refused_priority_is_logged_and_raises_no_error(monkeypatch, caplog):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level("INFO"):
        assert (
            "real-time scheduling was refused (Operation not permitted)"
            in request_urgent_priority()
        )
    assert "other work may delay what goes to the device" in caplog.text


class Scripted:
    """Camera with a given frame or error, and tracker that detects the number of the frame."""

    def __init__(self):
        self.frame = None
        self.resets = 0

    def latest(self):
        if isinstance(self.frame, Exception):
            raise self.frame
        return self.frame

    def find(self, frame):
        if frame.image is None:
            raise BadInput("frame.image", None, "an image")
        return Markers(np.full((2, 2), float(frame.number)), np.ones(2), np.ones(2))

    def reset(self):
        self.resets += 1


PICTURE = np.zeros((4, 4, 3), dtype=np.uint8)


def picture(number, exposure=0):
    return Frame(number, exposure, exposure, image=PICTURE)


def test_the_loop_receives_the_newest_processed_frame_with_its_markers():
    eye, clock = Scripted(), SteppedClock()
    thread = TrackingThread(eye, eye, clock)
    assert thread.latest() is None
    for number in (0, 1, 2):
        eye.frame = picture(number)
        clock.time = 100 + number
        thread.track_newest_frame()
        frame = thread.latest()
        eye.frame = picture(number + 50)
        thread.track_newest_frame()
        assert (frame.number, frame.arrival) == (number, 100 + number)
        assert np.array_equal(thread.find(frame).points, np.full((2, 2), float(number)))
    assert thread.latest().number == 52


def test_a_frame_is_tracked_once_and_stays_the_same_object():
    eye = Scripted()
    thread = TrackingThread(eye, eye, SteppedClock())
    eye.frame = picture(1)
    thread.track_newest_frame()
    first = thread.latest()
    thread.track_newest_frame()
    assert thread.latest() is first


def test_a_reset_of_the_loop_reaches_the_tracker_before_the_next_frame():
    eye = Scripted()
    thread = TrackingThread(eye, eye, SteppedClock())
    thread.reset()
    assert eye.resets == 0
    for number in range(3):
        eye.frame = picture(number)
        thread.track_newest_frame()
    assert eye.resets == 1


class Still:
    def enable(self):
        pass

    def measure(self):
        return ArmMeasurement(0, np.zeros(3), True)

    def apply(self, command):
        return command.rates


def test_a_frame_that_the_tracker_refuses_counts_as_damaged_and_the_next_does_not():
    eye, clock = Scripted(), SteppedClock()
    clock.time = 10
    thread = TrackingThread(eye, eye, clock)
    plant = Plant(Still(), thread, thread, clock)
    eye.frame = picture(1)
    thread.track_newest_frame()
    assert plant.read().frame == 1
    eye.frame = replace(picture(2, 1), image=None)
    thread.track_newest_frame()
    observation = plant.read()
    assert (observation.frame, observation.drop_reason) == (1, DropReason.DAMAGED)
    eye.frame = picture(3, 2)
    thread.track_newest_frame()
    observation = plant.read()
    assert (observation.frame, observation.drop_reason) == (3, DropReason.NONE)


def test_the_loop_never_waits_for_a_slow_tracker():
    busy, done = threading.Event(), threading.Event()

    class Slow(Scripted):
        def find(self, frame):
            busy.set()
            assert done.wait(WAIT_TIMEOUT_S)
            return super().find(frame)

    eye = Slow()
    eye.frame = picture(1)
    with TrackingThread(eye, eye, SteppedClock()) as thread:
        assert busy.wait(WAIT_TIMEOUT_S)
        assert thread.latest() is None
        done.set()


def test_a_slow_first_frame_is_awaited_but_a_silent_camera_is_not():
    """The clock advances once the tracker works, which takes half a minute."""
    at_work, later = threading.Event(), threading.Event()

    class Going(SteppedClock):
        def wait_until(self, time):
            assert at_work.wait(WAIT_TIMEOUT_S)
            super().wait_until(time)
            if self.time >= 30 * 10**9:
                later.set()

    class Compiled(Scripted):
        def find(self, frame):
            at_work.set()
            assert later.wait(WAIT_TIMEOUT_S)
            return super().find(frame)

    eye = Compiled()
    eye.frame = picture(1)
    with TrackingThread(eye, eye, Going()) as thread:
        thread.wait_for(frames=1, timeout_s=3.0)
        assert thread.latest().number == 1
    silent = Scripted()
    with TrackingThread(silent, silent, SteppedClock()) as thread:
        thread.wait_for(frames=1, timeout_s=3.0)
        assert thread.latest() is None


class FailingCamera(Scripted):
    """Camera that delivers a number of frames and then fails."""

    def __init__(self, frames):
        super().__init__()
        self.frames = frames

    def latest(self):
        if not self.frames:
            raise RuntimeError("cable")
        return self.frames.pop(0)


def wait_until_ended(thread):
    """Wait until the thread has ended by itself."""
    thread._thread.join(WAIT_TIMEOUT_S)
    assert not thread._thread.is_alive()


def test_an_error_after_the_first_frame_stops_the_frames_and_is_raised_at_the_end():
    eye = FailingCamera([picture(1)])
    with (
        pytest.raises(RuntimeError, match="cable"),
        TrackingThread(eye, eye, SteppedClock()) as thread,
    ):
        wait_until_ended(thread)
        assert thread.latest().number == thread.latest().number == 1


def test_an_error_before_the_first_frame_is_raised_at_once():
    eye = FailingCamera([])
    with (
        pytest.raises(RuntimeError, match="cable"),
        TrackingThread(eye, eye, SteppedClock()) as thread,
    ):
        wait_until_ended(thread)
        thread.latest()
        raise AssertionError("latest has not raised")


def test_a_camera_or_tracker_that_returns_another_type_is_named_in_the_error():
    eye = Scripted()
    eye.frame = [picture(1)]
    with pytest.raises(BadInput, match=r"Scripted\.latest\(\) must be a Frame"):
        TrackingThread(eye, eye, SteppedClock()).track_newest_frame()
    eye.frame, eye.find = picture(1), lambda frame: None
    with pytest.raises(BadInput, match=r"Scripted\.find\(\) must be Markers"):
        TrackingThread(eye, eye, SteppedClock()).track_newest_frame()
