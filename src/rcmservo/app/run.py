"""`rcmservo run`: a simulated run from the command line to a folder of results."""

import json
from dataclasses import dataclass, field

import tyro
from rich.console import Console
from rich.live import Live
from rich.text import Text

from rcmservo.app.folders import new_folder
from rcmservo.app.parse import OptionalPath
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.simulator import simulator
from rcmservo.app.tables import Story, show_run
from rcmservo.config.rig_file import Lab, load_lab, told_with
from rcmservo.errors import UnusableFile, require
from rcmservo.servo.servo import Servo

UNSETTLED = 1
"""Exit code of a run that did not settle."""


@dataclass(frozen=True)
class RunOptions:
    """Servo a simulated arm to a target that it was shown once, with a camera that nobody has
    calibrated."""

    seed: int = 0
    """Draws the camera, the start, the target and the noise."""
    duration: float = 30.0
    """Length of the run, s of simulated time."""
    estimator: EstimatorName = "projection"
    """How the Jacobian is learnt: projection is rule (21) with the fast Γ, projection-printed with
    the paper's Γ, flow is rule (28), broyden is the rank-1 update that III-C compares it to."""
    rig: OptionalPath = None
    """TOML file with your own mechanism, limits, tool, markers, camera, noise and scene."""
    out: OptionalPath = None
    """Folder to write to, new or empty; by default a new one under runs/."""
    video: bool = True
    """Write the overlay video."""
    frames: bool = False
    """Keep all frames in the record; `export` makes a recording of them."""
    disturb: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """What goes wrong, as kind:at=5,for=0.5,key=value; may be given several times. --disturb help
    lists all kinds."""
    target: OptionalPath = None
    """File with the target, as --save-target wrote it; by default the target is shown first."""
    save_target: OptionalPath = None
    """New file to keep the target in that was shown."""
    resumes: int = 0
    """How often a scripted person resumes after a pause, or shows the target again where that is
    needed."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    boxes: Boxes = field(default_factory=ServoOptions)


def run(command: RunOptions) -> int:
    require(command.seed >= 0, "--seed", command.seed, "a whole number that is not negative")
    require(
        1.0 < command.duration <= 3600.0,
        "--duration",
        command.duration,
        "more than 1 and at most 3600 s",
    )
    require(
        0 <= command.resumes <= 1000, "--resumes", command.resumes, "a whole number from 0 to 1000"
    )
    lab = load_lab(command.rig) if command.rig else Lab()
    with simulator("run"):
        from rcmservo.app.simulated_run.job import Job
        from rcmservo.app.simulated_run.simulate import simulate
        from rcmservo.sim.disturb import Disturbance, describe
        from rcmservo.sim.rig_file import rig_settings
    if "help" in command.disturb:
        print(describe())
        return 0
    if command.rig is not None:
        with told_with(command.rig):
            rig_settings(lab)  # reads the sections that only a simulation needs
    disturbances = tuple(Disturbance.parse(text) for text in command.disturb)
    shown = command.target is None or command.save_target is None
    require(
        shown,
        "--save-target",
        command.save_target,
        "left out with --target: no target is shown then",
    )
    if command.save_target is not None and command.save_target.exists():
        raise UnusableFile(
            command.save_target, "is there already, and nothing is overwritten: name a new file"
        )
    servo = Servo(
        mechanism=lab.mechanism,
        tool=lab.tool,
        estimator=command.boxes.estimators[command.estimator],
        controller=command.boxes.controller,
        exploration=command.boxes.exploration,
        imaged_rcm=command.boxes.imaged_rcm,
        gate=lab.gate,
        thresholds=lab.thresholds,
    )
    console = Console(stderr=command.json)
    with new_folder(command.out, f"run-seed{command.seed}") as folder:
        job = Job(
            command.seed,
            command.duration,
            command.estimator,
            servo,
            lab,
            folder,
            command.video,
            command.frames,
            disturbances,
            command.resumes,
            command.target,
            command.save_target,
        )
        console.print(f"[dim]simulated arm and camera, seed {command.seed}; preparing …[/dim]")
        with Live(Text(""), console=console, refresh_per_second=8, transient=True) as live:
            metrics = simulate(job, Story(live, command.duration))
    if command.json:
        print(json.dumps(metrics))
    else:
        show_run(console, metrics)
    return 0 if metrics["settled"] else UNSETTLED
