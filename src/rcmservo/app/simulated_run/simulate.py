"""One simulated run, from its settings to a folder: record, metrics, figures and video.

The servo is given what a real arm and camera would give it. The truth is read beside it, for the
record and the verdict only.
"""

import errno
import hashlib
import json
import os
import platform
import signal
import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config import target_file
from rcmservo.config.files import write_whole
from rcmservo.config.rig_file import Lab, build
from rcmservo.config.target_file import Setup
from rcmservo.errors import UnusableFile, require
from rcmservo.figures import charts, plots
from rcmservo.figures.overlay import draw
from rcmservo.figures.video import Video
from rcmservo.interfaces import Floats, Frame, Image, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick
from rcmservo.loop.teach import teach
from rcmservo.record import reader
from rcmservo.record.reader import RECORD
from rcmservo.record.verdict import LAST, Judge
from rcmservo.record.writer import RawFile, Recorder, created
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Drive, Killed, Look, Rig, RigSettings, SceneSettings, Timing
from rcmservo.sim.person import Person, attended
from rcmservo.tracking import ColourMarkers

METRICS = "metrics.json"

PAINTS: dict[str, tuple[float, float, float]] = {
    "red": (40.0, 35.0, 215.0),
    "green": (60.0, 185.0, 30.0),
    "blue": (205.0, 80.0, 25.0),
    "yellow": (30.0, 200.0, 210.0),
    "cyan": (200.0, 185.0, 30.0),
    "magenta": (190.0, 40.0, 200.0),
    "bright": (235.0, 235.0, 235.0),
}
"""Paint (blue, green, red) of a simulated ball by the colour that the tracker looks for."""


@dataclass(frozen=True)
class CameraSection:
    """[camera] of a rig file: the picture's size in px, its timing in s, and the point camera's
    noise in px."""

    width: int = 640
    height: int = 480
    frame_rate: float = 60.0
    exposure: float = 0.004
    delay: float = 0.02
    point_noise: float = 0.3


def rig_settings(lab: Lab) -> RigSettings:
    """The simulated laboratory of a rig file's [camera], [drive], [look] and [scene]."""
    camera = build(CameraSection, lab.simulation.get("camera", {}), "camera")
    paint, table = _paint(lab), lab.simulation.get("look", {})
    for key in paint:
        require(
            key not in table,
            f"look.{key}",
            table.get(key),
            "left out: [markers] tells radii and colours",
        )
    look = build(Look, {**table, **paint}, "look")
    return RigSettings(
        mechanism=lab.mechanism,
        tool=lab.tool,
        drive=build(Drive, lab.simulation.get("drive", {}), "drive"),
        timing=Timing(camera.frame_rate, camera.exposure, camera.delay),
        look=look,
        scene=build(SceneSettings, lab.simulation.get("scene", {}), "scene"),
        width=camera.width,
        height=camera.height,
        point_noise=camera.point_noise,
    )


def _paint(lab: Lab) -> dict[str, Any]:
    markers = lab.markers
    return {
        "marker_radii": (markers.radius_1, markers.radius_2),
        "marker_colours": (PAINTS[markers.colour_1], PAINTS[markers.colour_2]),
    }


def setup_of(rig: Rig, lab: Lab) -> Setup:
    """What a target that is shown to a simulated rig is bound to. Its camera's name follows from
    where it stands."""
    optics = rig.scene.optics
    where = np.concatenate(
        [[optics.focal], optics.centre, optics.distortion, optics.rotation.ravel(), optics.position]
    )
    view = hashlib.sha256(np.round(where, 6).tobytes()).hexdigest()[:8]
    name = f"simulation with seed {rig.seed}, view {view}"
    return Setup(name, optics.width, optics.height, lab.mechanism, lab.tool, lab.markers)


@dataclass(frozen=True)
class Job:
    """What to simulate and what to write.

    ``disturbances`` go wrong on the way; a scripted person acts at most ``resumes`` times after a
    pause. The target is that in the file ``target``, if one is given, and is otherwise shown;
    ``save_target`` is a file to keep it in.
    """

    seed: int
    duration: float
    name: str
    servo: Servo
    lab: Lab
    folder: Path
    video: bool = True
    frames: bool = False
    disturbances: tuple[Disturbance, ...] = ()
    resumes: int = 0
    target: Path | None = None
    save_target: Path | None = None


@dataclass
class _Explored:
    """What exploration cost, by the truth: when it ended, the path of marker 1 and how far it
    went."""

    time: float | None = None
    error: float | None = None
    path: float = 0.0
    farthest: float = 0.0
    places: list[Floats] = field(default_factory=list[Floats])

    def add(self, tick: Tick, p1: Floats, error: float) -> None:
        if self.time is not None:
            return
        if self.places:
            self.path += float(np.linalg.norm(p1 - self.places[-1]))
            self.farthest = max(self.farthest, float(np.linalg.norm(p1 - self.places[0])))
        self.places.append(p1)
        if tick.state.explored:
            self.time, self.error = tick.time / 1e9, error


class _Notes:
    """What becomes of a run, tick by tick: the verdict, by the truth how far off pose and Ĵ are,
    and the timing."""

    def __init__(self, job: Job, rig: Rig, target: Target) -> None:
        self._job, self._rig, self._p_d = job, rig, rig.body.points(rig.scene.target)[1]
        self._judge, self._explored = Judge(job.servo, target), _Explored()
        self._pose_errors: list[float] = []
        self._latencies: list[int] = []
        self._late, self._frame, self._jacobian_error = 0, -1, np.nan
        self._started = time.perf_counter()

    def add(self, tick: Tick, recorder: Recorder) -> None:
        """One tick more: note it, and record it with the truth beside it."""
        rig, state = self._rig, tick.state
        markers = rig.truth.markers(rig.clock.now())
        error = rig.truth.jacobian_error(state.J_hat, tick.seen.q_exposure, state.o_c)
        recorder.write(tick)
        recorder.write_truth(markers[0], markers[1], error)
        self._judge.add(tick)
        self._explored.add(tick, markers[0], error)
        self._pose_errors.append(float(np.linalg.norm(markers[1] - self._p_d)))
        self._jacobian_error = error
        self._late += state.watch.late > 0
        if tick.seen.frame > self._frame:
            self._frame = tick.seen.frame
            self._latencies.append(state.watch.latency)

    def metrics(self) -> dict[str, Any]:
        """The run in numbers."""
        job, outcome, explored = self._job, self._judge.outcome(), self._explored
        pose = np.array(self._pose_errors[-round(LAST * job.servo.rate) :])
        p50, p99 = (
            np.percentile(self._latencies, [50, 99]) * 1e-9 if self._latencies else (np.nan, np.nan)
        )
        return {
            "seed": job.seed,
            "estimator": job.name,
            "settled": outcome.settled,
            "cause": outcome.cause,
            "settle_time_s": outcome.settle_time if outcome.settled else None,
            "pose_error_mm": _number(np.sqrt(np.mean(pose**2))) if len(pose) else None,
            "feature_error": dict(
                zip(("s_rad", "r_px", "d_px"), map(_number, outcome.error), strict=True)
            ),
            "jacobian_error": {"explored": explored.error, "final": _number(self._jacobian_error)},
            "explore": {
                "time_s": explored.time,
                "path_mm": explored.path,
                "max_excursion_mm": explored.farthest,
            },
            "estimator_time_per_frame_s": getattr(job.servo.estimator, "estimator_time", 0.0)
            or None,
            "latency_s": {"median": _number(p50), "p99": _number(p99)},
            "late_ticks": self._late,
            "real_time_factor": self._judge.duration / (time.perf_counter() - self._started),
            "rejected_scenes": self._rig.scene.rejected,
            "folder": str(job.folder),
        }


def simulate(job: Job, progress: Callable[[Tick], None] = lambda tick: None) -> dict[str, Any]:
    """Run the job, write its folder, and return the metrics.

    Stopped by Ctrl-C it raises KeyboardInterrupt as usual, after the record so far was ended and
    the arm was at rest.
    """
    settings = rig_settings(job.lab)
    rig = Rig(job.seed, settings, disturbances=job.disturbances)
    plant = Plant(rig.arm, rig.camera, ColourMarkers(job.lab.markers), rig.clock)
    target = _target(job, rig, plant)
    job.servo.warm_up()
    person, notes, killed = Person(rig, plant, job.resumes), _Notes(job, rig, target), ""
    with ExitStack() as stack:
        recorder = stack.enter_context(
            Recorder(job.folder / RECORD, about(job, settings), _disk(rig))
        )
        plant.recorded = recorder.recorded
        video = _video(job, settings, stack)
        picture = _pictures(job, plant, video, recorder)
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


def _target(job: Job, rig: Rig, plant: Plant) -> Target:
    """The target of a file, or one that a person shows before bringing the tool back to the
    start."""
    setup = setup_of(rig, job.lab)
    if job.target is not None:
        return target_file.load(job.target, setup)
    rig.show_target()
    target = teach(plant)
    rig.go_home()
    if job.save_target is not None:
        target_file.save(job.save_target, target, setup)
    return target


class _FullDisk:
    """A record's file on a disk that is full while the rig says so."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self._file, self._rig = created(path), rig

    def write(self, data: memoryview, /) -> int | None:
        if self._rig.disk_full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def close(self) -> None:
        self._file.close()


def _disk(rig: Rig) -> Callable[[Path], RawFile]:
    return lambda path: _FullDisk(path, rig)


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


def _number(value: Any) -> float | None:
    """A finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


def about(job: Job, settings: RigSettings) -> dict[str, Any]:
    """What a record says of its run beside its stages (which hold servo and target): settings,
    seed, versions."""
    return {
        "simulation": True,
        "seed": job.seed,
        "duration_s": job.duration,
        "estimator": job.name,
        "mechanism": job.servo.mechanism.name,
        "disturbances": [str(disturbance) for disturbance in job.disturbances],
        "resumes": job.resumes,
        "rig": asdict(settings),
        "markers": asdict(job.lab.markers),
        "versions": {
            "rcmservo": version("rcmservo"),
            "python": platform.python_version(),
            **{
                name: version(name)
                for name in ("numpy", "numba", "opencv-python-headless", "mujoco-core")
            },
        },
    }


def _video(job: Job, settings: RigSettings, stack: ExitStack) -> Video | None:
    """The overlay video, if it is wanted."""
    if not job.video:
        return None
    video = Video(
        job.folder / "overlay.mp4", (settings.width, settings.height), settings.timing.frame_rate
    )
    stack.callback(video.close)
    return video


def _pictures(
    job: Job, plant: Plant, video: Video | None, recorder: Recorder
) -> Callable[[Tick], None]:
    """What to do with every new frame: the overlay video, and the record if it is to hold them."""
    shown: Frame | None = None

    def picture(tick: Tick) -> None:
        nonlocal shown
        frame = plant.frame
        if frame is None or frame.image is None or frame is shown:
            return
        shown = frame
        if video is not None:
            video.write(_overlay(frame.image, tick))
        if job.frames:
            recorder.write_frame(frame)

    return picture


def _overlay(image: Image, tick: Tick) -> Image:
    state = tick.state
    words = f"{state.cause.value}\n{tick.time * 1e-9:5.2f} s  {state.phase.value}"
    if np.isfinite(state.delta).all():
        s, r, d = np.degrees(state.delta[0]), state.delta[1], state.delta[2]
        words += f"  ds {s:+.2f} deg  dr {r:+.2f} px  dd {d:+.2f} px"
    target = np.full((2, 2), np.nan) if state.target is None else state.target.points
    return draw(image, tick.seen.points, state.o_c, target, words)


def draw_figures(folder: Path) -> None:
    """The figures of a run's record, where it came to hold anything to draw."""
    try:
        rows = reader.read(folder / RECORD)
    except UnusableFile:  # of a servo that was killed before it had one
        return
    if not np.isfinite(rows.ticks["delta"]).any():
        return
    charts.save(plots.errors(rows), folder / "errors.png")
    charts.save(plots.estimate(rows), folder / "estimate.png")
