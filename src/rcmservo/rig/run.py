"""Run of a rig: warm-up, confirmation, loop, record and result.

The loop itself is `rcmservo.loop.servo_loop`, the only one of the package that moves an arm.
"""

import platform
import sys
import tempfile
import weakref
from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rcmservo.config.class_registry import ESTIMATORS, find_class_name
from rcmservo.config.new_folder import open_new_folder
from rcmservo.interfaces import Target
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.loop.clock import DURATION
from rcmservo.loop.detection_failure import explain_undetected_markers
from rcmservo.loop.operator import Operator
from rcmservo.loop.run_result import RunResult, finite_or_none
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import SETTLED_DURATION_S, Settled, find_stop_cause
from rcmservo.recording.reader import RECORD, Record
from rcmservo.recording.timeline import summarise_record
from rcmservo.recording.writer import Recorder, ThreadedRecorder
from rcmservo.rig.confirmation import Confirm, require_confirmation
from rcmservo.rig.interrupt import deferred_interrupt
from rcmservo.rig.result import (
    RecordedResult,
    read_record_if_any,
    remove_empty_record,
    save_result,
)
from rcmservo.rig.rig import AnyRecorder, Rig, require_kind
from rcmservo.servo.servo import Servo

PACKAGES = "numpy", "numba", "opencv-python-headless"
"""Packages whose versions each record stores."""

PROGRESS_TICKS = 10
"""Number of ticks between two updates of the line of progress."""

CLEAR_LINE = "\r\033[K"
"""Control characters that clear a line of a terminal."""

Progress = Callable[[Tick], None]
"""Function that receives each tick of a run."""


class Course(NamedTuple):
    """Numbers and words of a run that its record does not hold.

    Parameters
    ----------
    stop_cause : str
        Cause that stopped the arm at the last tick; empty if nothing stopped it.
    true_errors_mm : deque[float]
        True distance of marker 2 from its taught position in the last second, mm; NaN if unknown.
    target : Target
        Target at the end.
    """

    stop_cause: str
    true_errors_mm: deque[float]
    target: Target


def run(
    rig: Rig,
    servo: Servo,
    target: Target,
    duration: float = 30.0,
    *,
    record: str | Path | None = None,
    until: Callable[[Tick], bool] | None = None,
    confirm: Confirm | None = None,
    operator: Operator | None = None,
    progress: Progress | None = None,
) -> RecordedResult:
    """Move the tool of a rig to a target and return the result.

    The servo is compiled, the person at a real arm confirms, the drive is switched on, and the tool
    moves: first on a short path around its start, then to the target. The run ends when the tool
    has settled, after `duration`, or with a stop that nobody can end. At the end, even after an
    error or Ctrl-C, the arm is brought to rest, its drive switched off and the record completed.

    Parameters
    ----------
    rig : Rig
        Arm, camera, tracker and robot: ``rs.sim.Rig(seed)``, ``rs.load_rig(file)`` or ``rs.Rig``.
        In wall time it is open, ``with rig:``.
    servo : Servo
        Method of the run. The mechanism and the tool are those of the rig.
    target : Target
        Target, from ``rig.teach()`` or a target file.
    duration : float
        Longest duration in s, positive; 30 by default.
    record : str, Path or None
        New folder for the record, the figures and metrics.json. Without one the record stays in a
        temporary folder as long as the result exists.
    until : Callable or None
        Function of a `Tick` that returns True to end the run; by default `Settled`.
    confirm : Callable or None
        Function such as `input` that shows the question if the drive may be switched on, and
        returns the answer of the person at the arm; only the answer ``enable`` switches it on.
        Needed unless ``rig.is_simulated``, as of ``rs.sim.Rig``.
    operator : Operator or None
        Function of a `Tick` that the loop calls after every tick, see `Operator`. Without one a
        pause ends the run.
    progress : Callable or None
        Function that receives each tick; by default a line on a terminal shows the phase.

    Returns
    -------
    RecordedResult
        Where the tool is in mm, how near that is to the target by the image and by the joints, the
        true error in a simulation, and what stopped it. ``print`` shows it in one line; `plot`,
        `save` and a notebook show more.

    Raises
    ------
    BadInput
        Before anything moves: if `duration`, `servo`, `target` or `confirm` is invalid.
    UnusableFile
        If `record` is not new or empty, or cannot be written.
    Stopped
        If the person at the arm does not confirm.
    NotReady
        In wall time, if the rig is not open.
    KeyboardInterrupt
        After Ctrl-C, once the arm is at rest. The record in the folder `record`, which is then its
        argument, is complete; without one it is lost.

    Notes
    -----
    The tool stays where the run ends. ``rig.go_home()`` brings that of a simulated rig back to its
    start, for example before a run with another servo.

    Errors of devices, and those of `servo_ticks`, of which this loop is made, reach the caller
    after the drive is off.
    """
    DURATION.require("duration", duration)
    require_kind("rig", rig, Rig, "a Rig, such as rs.sim.Rig()")
    require_kind("servo", servo, Servo, "a Servo, such as rs.Servo()")
    require_kind("target", target, Target, "a Target, such as rig.teach()")
    plant, servo = rig.plant, rig.adapt(servo)
    servo.require_target(target)
    servo.warm_up()
    ends = Settled() if until is None else until
    description = describe_run(rig, servo)
    with _open_folder(record) as (folder, keep):
        with _open_record(rig, folder, description) as recorder:
            recorder.begin(servo, target)
            rig.require_ready()
            require_confirmation(rig, servo, duration, confirm)
            ticks = servo_ticks(plant, servo, target, duration, ends, operator=operator)
            with _open_progress(progress) as show:
                course = _follow(rig, servo, ticks, target, recorder, show)
        recorded = read_record_if_any(folder)
        judged = replace(
            _judge(rig, recorded, course),
            folder=str(folder),
            simulated=rig.is_simulated,
            estimator=description["estimator"],
            seed=description.get("seed"),
            target_q=course.target.q.tolist(),
            not_recorded=recorder.failed,
        )
        result = RecordedResult(**vars(judged))
        if record is not None:
            return save_result(result, recorded, folder)
        keep(result)
        return result


def describe_run(rig: Rig, servo: Servo) -> dict[str, Any]:
    """Return the description of a run that its record stores."""
    return {
        **rig.describe(),
        "estimator": find_class_name(servo.estimator, ESTIMATORS),
        "mechanism": servo.mechanism.name,
        "versions": list_versions(),
    }


def list_versions(*packages: str) -> dict[str, str]:
    """Return the versions of rcmservo, Python, the `PACKAGES` and others, for a record."""
    names = "rcmservo", *PACKAGES, *packages
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


@contextmanager
def _open_folder(
    record: str | Path | None,
) -> Generator[tuple[Path, Callable[[RecordedResult], object]]]:
    """Yield the folder of the record, and a function that keeps it as long as a result exists.

    The folder is a temporary one if `record` is None.
    """
    if record is not None:
        with open_new_folder(Path(record), "") as folder:
            yield folder, lambda result: None
        return
    temporary = tempfile.TemporaryDirectory(prefix="rcmservo-")
    try:
        yield Path(temporary.name), lambda result: weakref.finalize(result, temporary.cleanup)
    except BaseException:
        temporary.cleanup()
        raise


@contextmanager
def _open_record(rig: Rig, folder: Path, description: dict[str, Any]) -> Generator[AnyRecorder]:
    """Yield the recorder, which the plant watches; remove the record of a run that did not begin.

    In wall time it has a thread, so that the loop never waits for a disk.
    """
    file, plant = Recorder(folder / RECORD, description), rig.plant
    watched = plant.recorded
    try:
        with ThreadedRecorder(file) if rig.is_in_wall_time else file as recorder:
            plant.recorded = recorder.recorded
            yield recorder
    except BaseException:
        remove_empty_record(folder)
        raise
    finally:
        plant.recorded = watched


def _follow(
    rig: Rig,
    servo: Servo,
    ticks: Generator[Tick],
    target: Target,
    recorder: AnyRecorder,
    progress: Progress,
) -> Course:
    """Record and show each tick of a run."""
    tick, has_accepted_frame = None, False
    true_errors_mm = deque[float](maxlen=round(SETTLED_DURATION_S * servo.rate))
    rig.begin()
    began_ns = rig.clock.now()
    realtime = apply_realtime_settings() if rig.is_in_wall_time else nullcontext()
    with realtime, deferred_interrupt() as raise_if_interrupted, closing(ticks):
        for tick in ticks:
            target = tick.state.target or target
            has_accepted_frame |= tick.state.accepted_frame >= 0
            rig.record_tick(recorder, tick)
            true_errors_mm.append(rig.measure_true_error(target))
            progress(tick)
            raise_if_interrupted()
    if tick is None:
        return Course("", true_errors_mm, target)
    reason = (
        ""
        if has_accepted_frame
        else explain_undetected_markers(rig.plant, tick.observation, began_ns)
    )
    return Course(find_stop_cause(tick.state.mode, reason), true_errors_mm, target)


def _judge(rig: Rig, record: Record | None, course: Course) -> RunResult:
    """Return the result of the record, with the true error and what only the devices know."""
    result = RunResult() if record is None else summarise_record(record)
    errors_mm = np.array(course.true_errors_mm)
    true_error_mm = np.sqrt(np.mean(errors_mm**2)) if len(errors_mm) else np.nan
    used_frames = 0 if result.frames is None else result.frames.used
    count_frames = getattr(rig.camera, "counts", None)
    off_reason = getattr(rig.arm, "off_reason", "")
    cause = "" if result.settled else course.stop_cause or result.cause
    return replace(
        result if not off_reason else result.unsettled(off_reason),
        cause=cause or off_reason,
        pose_error_mm=finite_or_none(float(true_error_mm)),
        bound_mm=finite_or_none(rig.compute_bound(course.target, used_frames)),
        camera=None if count_frames is None else count_frames(),
        drive_off=off_reason,
    )


@contextmanager
def _open_progress(progress: Progress | None) -> Generator[Progress]:
    """Yield the function that receives each tick; by default it rewrites a line on a terminal."""
    if progress is not None or not sys.stderr.isatty():
        yield progress or (lambda tick: None)
        return
    try:
        yield _show_progress
    finally:
        sys.stderr.write(CLEAR_LINE)


def _show_progress(tick: Tick) -> None:
    """Rewrite one line on the terminal with time, phase and cause."""
    if round(tick.time * 1e-9 * tick.servo.rate) % PROGRESS_TICKS == 0:
        sys.stderr.write(f"{CLEAR_LINE}{tick.time * 1e-9:6.2f} s  {tick.state.text}"[:200])
        sys.stderr.flush()
