"""Simulated run, from its settings to a folder with record, metrics, figures and video.

The servo receives only what a real arm and camera provide. The true state is used for the record
and the result.
"""

import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.cli.result_output import read_record_if_any, save_result
from rcmservo.cli.run_description import describe_simulated_run
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.simulated_run.target import obtain_target
from rcmservo.cli.simulated_run.video import make_frame_writer, open_video
from rcmservo.interfaces import Floats
from rcmservo.loop.detection_failure import reason_not_detected
from rcmservo.loop.plant import Plant
from rcmservo.loop.run_result import RunResult, finite_or_none
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import SETTLED_DURATION_S, find_stop_cause
from rcmservo.recording.reader import RECORD, Record
from rcmservo.recording.timeline import read_rate, summarise
from rcmservo.recording.writer import Recorder
from rcmservo.sim import Killed, Rig
from rcmservo.sim.disturbances.computer_faults import open_on_filling_disk
from rcmservo.sim.scripted_operator import ScriptedOperator, run_attended
from rcmservo.tracking import ColourMarkers


def simulate(
    options: RunOptions, folder: Path, progress: Callable[[Tick], None] = lambda tick: None
) -> RunResult:
    """Run a simulation, write its folder and return its result.

    Parameters
    ----------
    options : RunOptions
        Settings of the run.
    folder : Path
        Empty output folder.
    progress : Callable
        Function that receives each tick.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C, once the record is complete and the arm is at rest.
    """
    servo, lab, settings = options.servo, options.lab, options.rig_settings
    rig = Rig(options.seed, settings, disturbances=options.disturbances)
    plant = Plant(rig.arm, rig.camera, ColourMarkers(lab.markers), rig.clock)
    target = obtain_target(options, rig, plant)
    servo.warm_up()
    operator = ScriptedOperator(rig, plant, options.resumes, options.teaching_frames)
    disturbances = [str(disturbance) for disturbance in options.disturbances]
    description = describe_simulated_run(options, options.duration) | {
        "disturbances": disturbances,
        "resumes": options.resumes,
    }
    started = time.perf_counter()
    with ExitStack() as stack:
        recorder = stack.enter_context(
            Recorder(folder / RECORD, description, open_on_filling_disk(rig.disk_full))
        )
        video = open_video(folder, settings, stack) if options.video else None
        plant.recorded = recorder.recorded
        begin_record = partial(recorder.begin, servo)
        ticks = run_attended(rig, plant, servo, target, options.duration, operator, begin_record)
        observers = make_frame_writer(plant, video, recorder if options.frames else None), progress
        reason = _record_ticks(ticks, rig, plant, recorder, observers)
    took, record = time.perf_counter() - started, read_record_if_any(folder)
    result = RunResult() if record is None else _make_result(rig, record)
    result = replace(
        result,
        cause="" if result.settled else reason or result.cause,
        seed=options.seed,
        estimator=options.estimator,
        estimator_time_per_frame_s=getattr(servo.estimator, "estimator_time", 0.0) or None,
        rejected_scenes=rig.scene.rejected,
        real_time_factor=None if result.duration_s is None else result.duration_s / took,
        resumed=operator.resumed,
        refused=operator.refused,
        taught_again=operator.taught,
        not_recorded=recorder.failed,
        not_filmed=video.failed if video is not None else "",
    )
    return save_result(result, record, folder)


def _make_result(rig: Rig, record: Record) -> RunResult:
    """Return the result of a record, with the true pose error over the last second."""
    result, p2 = summarise(record), record.truth["p2"]
    p_d = rig.body.points(rig.scene.target)[1]
    pose: Floats = np.linalg.norm(
        p2[-round(SETTLED_DURATION_S * read_rate(record)) :] - p_d, axis=1
    )
    error = finite_or_none(float(np.sqrt(np.mean(pose**2)))) if len(pose) else None
    return replace(result, pose_error_mm=error)


def _record_ticks(
    ticks: Generator[Tick],
    rig: Rig,
    plant: Plant,
    recorder: Recorder,
    observers: Iterable[Callable[[Tick], None]],
) -> str:
    """Record and observe each tick of a run; return the reason if it ended early."""
    tick, start, ever_accepted = None, rig.clock.now(), False
    rig.begin()
    with _deferred_interrupt() as raise_if_interrupted, closing(ticks):
        try:
            for tick in ticks:
                ever_accepted = ever_accepted or tick.state.accepted_frame >= 0
                rig.truth.write(recorder, tick)
                for observe in observers:
                    observe(tick)
                raise_if_interrupted()
        except Killed as end:
            return f"{end}; the arm's watchdog stops it"
    if tick is None:
        return ""
    return find_stop_cause(
        tick.state.mode,
        "" if ever_accepted else reason_not_detected(plant, tick.observation, start),
    )


@contextmanager
def _deferred_interrupt() -> Generator[Callable[[], None]]:
    """Yield a function that raises KeyboardInterrupt if Ctrl-C was pressed.

    Ctrl-C thus takes effect between ticks only and never interrupts the writing of a message.
    """
    pressed = False

    def press(number: int, frame: object) -> None:
        nonlocal pressed
        pressed = True

    def raise_if_pressed() -> None:
        if pressed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield raise_if_pressed
        return
    previous = signal.signal(signal.SIGINT, press)
    try:
        yield raise_if_pressed
    finally:
        signal.signal(signal.SIGINT, previous)
