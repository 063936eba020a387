"""Simulated run, from its settings to a folder with record, metrics, figures and video.

The servo receives only what a real arm and camera provide. The true state is used for the record
and the result.
"""

import math
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.cli.progress.compilation import compiled_in_parallel
from rcmservo.cli.run_description import describe_simulated_run
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.simulated_run.target import obtain_target
from rcmservo.cli.simulated_run.video import FRAMES_PER_VIDEO_IMAGE, make_frame_writer, open_video
from rcmservo.hardware.device_kinds import make_tracker
from rcmservo.interfaces import Floats
from rcmservo.loop.detection_failure import explain_undetected_markers
from rcmservo.loop.plant import Plant
from rcmservo.loop.run_result import RunResult, finite_or_none
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import SETTLED_DURATION_S, find_stop_cause
from rcmservo.recording.reader import RECORD, Record
from rcmservo.recording.timeline import read_rate, summarise_record
from rcmservo.recording.writer import Recorder
from rcmservo.rig.interrupt import deferred_interrupt
from rcmservo.rig.result import read_record_if_any, save_result
from rcmservo.sim import Killed, Rig
from rcmservo.sim.disturbances.effects.computer_faults import open_on_filling_disk
from rcmservo.sim.scripted_operator import ScriptedOperator, run_attended


def simulate(
    options: RunOptions,
    folder: Path,
    progress: Callable[[Tick], None] = lambda tick: None,
    count_kernel: Callable[[], None] = lambda: None,
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
    count_kernel : Callable
        Function that is called for each kernel that a second process has compiled.

    Returns
    -------
    RunResult
        Result, as metrics.json stores it.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C, once the record is complete and the arm is at rest.
    """
    servo, settings = options.servo, options.rig_settings
    with compiled_in_parallel(partial(_warm_up_servo, options), count_kernel):
        rig = Rig(options.seed, settings, disturbances=options.disturbances)
        plant = Plant(rig.arm, rig.camera, make_tracker(options.lab), rig.clock)
        target = obtain_target(options, rig, plant)
    servo.warm_up()
    operator = ScriptedOperator(rig, plant, options.resumes, options.teaching_frames)
    description = describe_simulated_run(options, options.duration) | {
        "disturbances": [str(disturbance) for disturbance in options.disturbances],
        "resumes": options.resumes,
    }
    start_s = time.perf_counter()
    with ExitStack() as stack:
        recorder = stack.enter_context(
            Recorder(folder / RECORD, description, open_on_filling_disk(rig.disk_full))
        )
        video = (
            open_video(stack, folder, settings, FRAMES_PER_VIDEO_IMAGE) if options.video else None
        )
        plant.recorded = recorder.recorded
        begin_record = partial(recorder.begin, servo)
        ticks = run_attended(rig, plant, servo, target, options.duration, operator, begin_record)
        frame_recorder = recorder if options.frames else None
        write_frame = make_frame_writer(plant, video, frame_recorder, FRAMES_PER_VIDEO_IMAGE)
        observers = write_frame, progress
        end_reason = _record_ticks(ticks, rig, plant, recorder, observers)
    wall_time_s, record = time.perf_counter() - start_s, read_record_if_any(folder)
    result = RunResult() if record is None else _make_result(rig, record)
    result = replace(
        result,
        cause="" if result.settled else end_reason or result.cause,
        seed=options.seed,
        estimator=options.estimator,
        estimator_time_per_frame_s=getattr(servo.estimator, "estimator_time", 0.0) or None,
        rejected_scenes=rig.scene.rejected,
        real_time_factor=None if result.duration_s is None else result.duration_s / wall_time_s,
        resumed=operator.resumed,
        refused=operator.refused,
        taught_again=operator.taught,
        not_recorded=recorder.failed,
        not_filmed=video.failed if video is not None else "",
    )
    return save_result(result, record, folder)


def _warm_up_servo(options: RunOptions) -> None:
    options.servo.warm_up()


def _make_result(rig: Rig, record: Record) -> RunResult:
    """Return the result of a record, with the rms pose error of marker 2 over the last second."""
    p_d = rig.body.points(rig.true_target)[1]
    last_ticks = round(SETTLED_DURATION_S * read_rate(record))
    displacements: Floats = record.truth["p2"][-last_ticks:] - p_d
    errors_mm: Floats = np.linalg.norm(displacements, axis=1)
    rms_mm = float(np.sqrt(np.mean(errors_mm**2))) if len(errors_mm) else math.nan
    return replace(summarise_record(record), pose_error_mm=finite_or_none(rms_mm))


def _record_ticks(
    ticks: Generator[Tick],
    rig: Rig,
    plant: Plant,
    recorder: Recorder,
    observers: Iterable[Callable[[Tick], None]],
) -> str:
    """Record and observe each tick of a run; return the reason if it ended early."""
    tick, start, has_accepted_frame = None, rig.clock.now(), False
    rig.begin()
    with deferred_interrupt() as raise_if_interrupted, closing(ticks):
        try:
            for tick in ticks:
                has_accepted_frame |= tick.state.accepted_frame >= 0
                rig.truth.record_tick(recorder, tick)
                for observe in observers:
                    observe(tick)
                raise_if_interrupted()
        except Killed as end:
            return f"{end}; the arm's watchdog stops it"
    if tick is None:
        return ""
    reason = (
        "" if has_accepted_frame else explain_undetected_markers(plant, tick.observation, start)
    )
    return find_stop_cause(tick.state.mode, reason)
