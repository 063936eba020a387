"""One simulated run, from its settings to a folder: record, metrics, figures and video.

The servo is given what a real arm and camera would give it. The truth is read beside it, for the
record and the verdict only.
"""

import json
import signal
import threading
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

from rcmservo.app.simulated_run.job import Job, about
from rcmservo.app.simulated_run.metrics import METRICS, Notes
from rcmservo.app.simulated_run.pictures import draw_figures, pictures, video_of
from rcmservo.app.simulated_run.target import target_of
from rcmservo.config.files import write_whole
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick
from rcmservo.record.reader import RECORD
from rcmservo.record.writer import Recorder
from rcmservo.sim import Killed, Rig
from rcmservo.sim.disturb.disk import disk
from rcmservo.sim.person import Person, attended
from rcmservo.sim.rig_file import rig_settings
from rcmservo.tracking import ColourMarkers


def simulate(job: Job, progress: Callable[[Tick], None] = lambda tick: None) -> dict[str, Any]:
    """Run the job, write its folder, and return the metrics.

    Stopped by Ctrl-C it raises KeyboardInterrupt as usual, after the record so far was ended and
    the arm was at rest.
    """
    settings = rig_settings(job.lab)
    rig = Rig(job.seed, settings, disturbances=job.disturbances)
    plant = Plant(rig.arm, rig.camera, ColourMarkers(job.lab.markers), rig.clock)
    target = target_of(job, rig, plant)
    job.servo.warm_up()
    person, notes, killed = Person(rig, plant, job.resumes), Notes(job, rig, target), ""
    with ExitStack() as stack:
        recorder = stack.enter_context(
            Recorder(job.folder / RECORD, about(job, settings), disk(rig.disk_full))
        )
        plant.recorded = recorder.recorded
        video = video_of(job, settings, stack)
        picture = pictures(job, plant, video, recorder)
        stopped = stack.enter_context(_between_ticks())
        begins = partial(recorder.begin, job.servo)
        rig.begin()
        try:
            for tick in attended(rig, plant, job.servo, target, job.duration, person, begins):
                notes.add(tick, recorder)
                picture(tick)
                progress(tick)
                stopped()
        except Killed as end:
            killed = f"{end}; the arm's watchdog stops it"
    metrics = notes.metrics()
    metrics |= {"settled": False, "settle_time_s": None, "cause": killed} if killed else {}
    metrics |= {"resumed": person.resumed, "refused": person.refused, "shown_again": person.shown}
    metrics |= {
        "not_recorded": recorder.failed,
        "not_filmed": video.failed if video is not None else "",
    }
    return keep(job, metrics)


def keep(job: Job, metrics: dict[str, Any]) -> dict[str, Any]:
    """Write the metrics and the figures of a run that was recorded."""
    write_whole(job.folder / METRICS, json.dumps(metrics, indent=2) + "\n")
    draw_figures(job.folder)
    return metrics


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
