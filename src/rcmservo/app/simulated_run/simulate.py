"""One simulated run, from its settings to a folder: record, metrics, figures and video.

The servo is given what a real arm and camera would give it. The truth is read beside it, for the
record and the verdict only.
"""

import json
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path

from rcmservo.app.lab_options import RunOptions
from rcmservo.app.run_figures import draw_figures
from rcmservo.app.simulated_run.about import about
from rcmservo.app.simulated_run.metrics import METRICS, RunMetrics, Unrecorded, measured
from rcmservo.app.simulated_run.pictures import pictures, video_of
from rcmservo.app.simulated_run.target import target_of
from rcmservo.app.simulated_run.unwritten import written
from rcmservo.config.files import write_whole
from rcmservo.errors import UnusableFile
from rcmservo.loop.plant import Plant
from rcmservo.loop.tick import Tick
from rcmservo.loop.unseen import unseen
from rcmservo.record import reader
from rcmservo.record.reader import RECORD
from rcmservo.record.verdict import held
from rcmservo.record.writer import Recorder
from rcmservo.sim import Killed, Rig
from rcmservo.sim.disturbances.computer_faults import disk
from rcmservo.sim.scripted_operator import ScriptedPerson, attended
from rcmservo.tracking import ColourMarkers


def simulate(
    options: RunOptions, folder: Path, progress: Callable[[Tick], None] = lambda tick: None
) -> RunMetrics:
    """Run what the options ask for, write the folder, and return the metrics.

    Stopped by Ctrl-C it raises KeyboardInterrupt as usual, after the record so far was ended and
    the arm was at rest.
    """
    servo, lab, settings = options.servo, options.lab, options.rig_settings
    rig = Rig(options.seed, settings, disturbances=options.disturbances)
    plant = Plant(rig.arm, rig.camera, ColourMarkers(lab.markers), rig.clock)
    target = target_of(options, rig, plant)
    servo.warm_up()
    person = ScriptedPerson(rig, plant, options.resumes, options.teaching_frames)
    wrong = [str(disturbance) for disturbance in options.disturbances]
    words = about(options, options.duration) | {"disturbances": wrong, "resumes": options.resumes}
    started = time.perf_counter()
    with ExitStack() as stack:
        recorder = stack.enter_context(Recorder(folder / RECORD, words, disk(rig.disk_full)))
        video = video_of(folder, settings, stack) if options.video else None
        plant.recorded = recorder.recorded
        begins = partial(recorder.begin, servo)
        ticks = attended(rig, plant, servo, target, options.duration, person, begins)
        shown = pictures(plant, video, recorder if options.frames else None), progress
        ended = _follow(ticks, rig, plant, recorder, shown)
    metrics = RunMetrics(
        options.seed,
        options.estimator,
        cause=ended or RunMetrics.cause,
        estimator_time_per_frame_s=getattr(servo.estimator, "estimator_time", 0.0) or None,
        rejected_scenes=rig.scene.rejected,
        folder=str(folder),
        resumed=person.resumed,
        refused=person.refused,
        shown_again=person.shown,
        not_recorded=recorder.failed,
        not_filmed=video.failed if video is not None else "",
    )
    p_d = rig.body.points(rig.scene.target)[1]
    return _kept(folder, metrics, Unrecorded(p_d, time.perf_counter() - started, ended))


def _follow(
    ticks: Generator[Tick],
    rig: Rig,
    plant: Plant,
    recorder: Recorder,
    shown: Iterable[Callable[[Tick], None]],
) -> str:
    """Record and show every tick of a run; what ended it before its time, in words."""
    tick, began, ever = None, rig.clock.now(), False
    rig.begin()
    with _between_ticks() as stopped, closing(ticks):
        try:
            for tick in ticks:
                ever = ever or tick.state.believed >= 0
                rig.truth.write(recorder, tick)
                for show in shown:
                    show(tick)
                stopped()
        except Killed as end:
            return f"{end}; the arm's watchdog stops it"
    if tick is None:
        return ""
    return held(tick.state.mode, "" if ever else unseen(plant, tick.seen, began))


def _kept(folder: Path, metrics: RunMetrics, beside: Unrecorded) -> RunMetrics:
    """The metrics with what the record tells, written beside it with its figures.

    What cannot be written is told in them: the result is not lost with it.
    """
    with suppress(UnusableFile):  # of a servo that was killed before it recorded anything
        record = reader.read(folder)
        metrics = measured(metrics, record, beside)
        metrics = written(metrics, lambda: draw_figures(record, folder))
    text = json.dumps(asdict(metrics), indent=2) + "\n"
    return written(metrics, lambda: write_whole(folder / METRICS, text))


@contextmanager
def _between_ticks() -> Generator[Callable[[], None]]:
    """Ctrl-C takes effect where the function that this gives is called, so that it never cuts a
    message in two."""
    pressed = False

    def press(number: int, frame: object) -> None:
        nonlocal pressed
        pressed = True

    def stopped() -> None:
        if pressed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield stopped
        return
    usual = signal.signal(signal.SIGINT, press)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGINT, usual)
