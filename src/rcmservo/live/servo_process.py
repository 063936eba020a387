"""The host's side of a live run: the process that servos, and nothing of a simulator in it.

Everything is connected, taught, compiled and warmed up before the arm is enabled. While it is, this
process does three things: the loop, which waits for nobody; beside it the markers are tracked; and
aside, ticks are recorded and reported.
"""

import contextlib
import queue
import signal
import threading
import traceback
from contextlib import closing
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Command, Floats, Target
from rcmservo.live.arm_link import RemoteArm, Wish
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.realtime import Realtime, realtime
from rcmservo.live.tracking_thread import Beside
from rcmservo.loop.clock import Punctuality, WallClock, ticks
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.record.verdict import Judge
from rcmservo.record.writer import Recorder, ThreadedRecorder
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers, MarkerLook

EVERY = 10
"""Ticks from one report to the next."""

STANDING = -1
"""What the heartbeat tells while no loop runs."""


PATIENCE = 120.0
"""s within which a camera must deliver a frame, and what tracks the markers in it be loaded or
compiled."""


class NoFrames(RcmServoError):
    """A camera that delivers nothing."""


@dataclass(frozen=True)
class Task:
    """What a live servo is to do: for how long (s), and which file to record in, with what it says
    of the run."""

    servo: Servo
    markers: MarkerLook
    duration: float
    record: Path
    about: dict[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True, eq=False)
class Report:
    """How the loop stands: its time ns, the phase and cause in words, the error Δy (3,) and the
    scaled condition."""

    time: int
    words: str
    delta: Floats
    condition: float


class Beating(Plant):
    """A plant that counts its commands in ``beats``, also those that bring the arm to rest: a
    heartbeat."""

    beats: Any

    def send(self, command: Command) -> Floats:
        self.beats.value += 1
        return super().send(command)


class Aside:
    """A thread that takes the ticks from the loop, collects what the verdict needs, and reports."""

    def __init__(self, servo: Servo, target: Target, told: Connection) -> None:
        self.judge = Judge(servo, target)
        self.moments: list[int] = []
        self.times: list[int] = []
        self.latencies: list[int] = []
        self._told = told
        self._ticks: queue.SimpleQueue[Tick | None] = queue.SimpleQueue()
        self._frame = -1
        self._thread = threading.Thread(target=self._work, name="reports", daemon=True)
        self.put = self._ticks.put

    def __enter__(self) -> "Aside":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ticks.put(None)
        self._thread.join()

    def _work(self) -> None:
        for tick in iter(self._ticks.get, None):
            self.judge.add(tick)
            self.moments.append(tick.seen.now)
            self.times.append(tick.time)
            if tick.seen.frame > self._frame:
                self._frame = tick.seen.frame
                self.latencies.append(tick.state.watch.latency)
            if len(self.times) % EVERY == 1:
                self._report(tick)

    def _report(self, tick: Tick) -> None:
        state = tick.state
        with contextlib.suppress(OSError):
            self._told.send(Report(tick.time, state.words, state.delta, state.condition))


def serve(folder: Path, ring: FrameRing, beats: Any, task: Task, told: Connection) -> None:
    """Servo until the task is done, or until the other end of `told` speaks or is gone.

    ``beats`` counts the ticks while the loop runs. What is sent: a Report now and then, at the end
    the measures of the run (a dict), an RcmServoError, or, of an error in the software, its
    traceback (str).
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    beats.value = STANDING
    try:
        said: Any = _live(folder, ring, beats, task, told)
    except RcmServoError as error:
        said = RcmServoError(str(error))
    except Exception:
        said = traceback.format_exc()
    with contextlib.suppress(OSError):  # of a supervisor that is gone
        told.send(said)


def _live(
    folder: Path, ring: FrameRing, beats: Any, task: Task, told: Connection
) -> dict[str, Any]:
    servo, clock = task.servo, Punctuality(WallClock())
    with (
        closing(RemoteArm(folder)) as arm,
        Beside(RingCamera(ring), ColourMarkers(task.markers), clock.clock) as eye,
    ):
        plant = Beating(arm, eye, eye, clock)
        target = shown(arm, plant)
        about = {**task.about, "target_px": target.points.tolist()}
        with (
            ThreadedRecorder(Recorder(task.record, about)) as recorder,
            Aside(servo, target, told) as aside,
        ):
            recorder.begin(servo, target)
            servo.warm_up()
            plant.recorded = recorder.recorded
            first = len(clock.lateness)
            with realtime() as got:
                try:
                    plant.beats = beats
                    for tick in run(plant, servo, target, task.duration, lambda tick: told.poll()):
                        recorder.write(tick)
                        aside.put(tick)
                finally:
                    beats.value = STANDING
    lateness = np.array(clock.lateness[first:][: len(aside.times)], dtype=float)
    return {
        **_verdict(aside),
        "not_recorded": recorder.failed,
        "target_q": target.q.tolist(),
        "loop": _timing(aside, lateness, servo.rate, got),
    }


def shown(arm: RemoteArm, plant: Plant) -> Target:
    """A person shows the target and brings the tool back; it is there in the newest frame when this
    returns."""
    for _ in range(
        2
    ):  # the first frame is searched, the next is followed: after both nothing needs to be loaded
        _await_frame(plant)
    arm.ask(Wish.SHOW)
    target = teach(plant)
    arm.ask(Wish.HOME)
    _await_frame(plant)
    return target


def _await_frame(plant: Plant) -> None:
    """Wait for a frame that is exposed from now on."""
    now = plant.clock.now()
    for _ in ticks(plant.clock, duration=PATIENCE):
        if plant.read().exposure >= now:
            return
    raise NoFrames(f"no frame has come from the camera for {PATIENCE:g} s")


def _verdict(aside: Aside) -> dict[str, Any]:
    outcome = aside.judge.outcome()
    return {
        "settled": outcome.settled,
        "cause": outcome.cause,
        "settle_time_s": outcome.settle_time if outcome.settled else None,
        "feature_error": {
            name: _number(x)
            for name, x in zip(("s_rad", "r_px", "d_px"), outcome.error, strict=True)
        },
        "explored_s": outcome.explored_at,
    }


def _timing(aside: Aside, lateness: Floats, rate: float, got: Realtime) -> dict[str, Any]:
    """How the loop kept its time: Hz and ms. A tick is missed if the loop was not there to begin
    it."""
    times, moments = aside.times, np.array(aside.moments, dtype=float)
    count = len(times)
    span = moments[-1] - moments[0] if count > 1 else np.nan
    return {
        "ticks": count,
        "missed": round(times[-1] * rate * 1e-9) + 1 - count if count else 0,
        "rate_hz": _number((count - 1) / span * 1e9),
        "lateness_ms": _spread(lateness, 50, 99, 100),
        "latency_ms": _spread(np.array(aside.latencies, dtype=float), 50, 99),
        "collections": got.collections,
        "refused": got.refused,
    }


def _spread(ns: Floats, *percentiles: int) -> dict[str, float | None]:
    """Percentiles in ms of times in ns, the 100th as their maximum."""
    names = {50: "median", 99: "p99", 100: "max"}
    return {
        names[p]: _number(np.percentile(ns, p) * 1e-6) if len(ns) else None for p in percentiles
    }


def _number(value: Any) -> float | None:
    """A finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None
