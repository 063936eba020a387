"""`rcmservo run`: a simulated run from the command line to a folder of results."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tyro
from rich.live import Live
from rich.text import Text

from rcmservo.app.folders import new_folder, require_new
from rcmservo.app.parse import OptionalPath
from rcmservo.app.result_output import report
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.simulated_run.progress import RunProgress
from rcmservo.app.terminal import console
from rcmservo.app.waiting.preparing import compiling
from rcmservo.config.rig_file import Lab, load_lab, told_with
from rcmservo.errors import needing, require
from rcmservo.loop.shown import TEACHING_FRAMES, require_frames

if TYPE_CHECKING:
    from rcmservo.app.simulated_run.job import Job


@dataclass(frozen=True)
class RunOptions:
    """Servo a simulated arm to a target that it was shown once, with a camera that nobody has
    calibrated."""

    seed: int = 0
    """Draws camera, start, target and noise."""
    duration: float = 30.0
    """Length of the run, s of simulated time."""
    estimator: EstimatorName = "dlt"
    """The estimator of the Jacobian: one of those below, or your own."""
    rig: OptionalPath = None
    """TOML file with your own mechanism, limits, tool, markers, camera, noise and scene."""
    out: OptionalPath = None
    """Folder to write to, new or empty; by default a new one under runs/."""
    video: bool = True
    """Write the overlay video."""
    frames: bool = False
    """Keep all frames in the record, for `export`."""
    disturb: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """What goes wrong, as kind:at=5,for=0.5,key=value; may be given several times. --disturb help
    lists all kinds."""
    target: OptionalPath = None
    """File with the target, as --save-target wrote it; by default the target is shown first."""
    save_target: OptionalPath = None
    """New file to keep the target in that was shown."""
    teaching_frames: int = TEACHING_FRAMES
    """Frames that a target is the mean of: 300 are 5 s at 60 frames/s."""
    resumes: int = 0
    """How often a scripted person resumes after a pause, or shows the target again where that is
    needed."""
    json: bool = False
    """Print one JSON object and nothing else."""
    boxes: Boxes = field(default_factory=ServoOptions)
    """The settings of the servo's boxes."""


def run(options: RunOptions) -> int:
    """Run, write the folder, print the result; the exit code is 0 where it settled."""
    _check(options)
    lab = load_lab(options.rig) if options.rig else Lab()
    with needing("run", "sim"):
        from rcmservo.sim.disturbances import describe
    if "help" in options.disturb:
        print(describe())
        return 0
    out = console(stderr=options.json)
    with new_folder(options.out, f"run-seed{options.seed}") as folder:
        job = _job(options, lab, folder)
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        out.print(words, style="dim", soft_wrap=True)
        with Live(Text(""), console=out, refresh_per_second=8, transient=True) as line:
            from rcmservo.app.simulated_run.simulate import simulate

            with compiling(line):
                result = simulate(job, RunProgress(line, options.duration))
    return report(out, result, options.json)


def _check(options: RunOptions) -> None:
    """Refuse what cannot be run."""
    require(options.seed >= 0, "--seed", options.seed, "a whole number that is not negative")
    good = 1.0 < options.duration <= 3600.0
    require(good, "--duration", options.duration, "more than 1 and at most 3600 s")
    good = 0 <= options.resumes <= 1000
    require(good, "--resumes", options.resumes, "a whole number from 0 to 1000")
    require_frames(options.teaching_frames, "--teaching-frames")
    require_new(options.target, options.save_target)


def _job(options: RunOptions, lab: Lab, folder: Path) -> "Job":
    """What the options ask for."""
    from rcmservo.app.simulated_run.job import Job
    from rcmservo.sim.disturbances import Disturbance
    from rcmservo.sim.rig_file import rig_settings

    if options.rig is not None:
        with told_with(options.rig):
            rig_settings(lab)  # reads the sections that only a simulation needs
    return Job(
        options.seed,
        options.duration,
        options.estimator,
        options.boxes.servo(options.estimator, lab),
        lab,
        folder,
        options.video,
        options.frames,
        tuple(Disturbance.parse(text) for text in options.disturb),
        options.resumes,
        options.target,
        options.save_target,
        options.teaching_frames,
    )
