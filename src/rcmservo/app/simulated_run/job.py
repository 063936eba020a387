"""What to simulate, what to write, and what the record says of it."""

import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rcmservo.config.rig_file import Lab
from rcmservo.loop.shown import TEACHING_FRAMES
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, RigSettings


@dataclass(frozen=True)
class Job:
    """What to simulate and what to write."""

    seed: int
    """What camera, start, target and noise are drawn from."""
    duration: float
    """Length of the run, s."""
    name: str
    """The estimator's name on the command line."""
    servo: Servo
    """What is to reach the target, with its settings."""
    lab: Lab
    """The laboratory that is simulated."""
    folder: Path
    """Where record, metrics, figures and video go."""
    video: bool = True
    """Whether to write the overlay video."""
    frames: bool = False
    """Whether the record holds the frames too."""
    disturbances: tuple[Disturbance, ...] = ()
    """What goes wrong on the way."""
    resumes: int = 0
    """How often at most a scripted person acts after a pause: resumes, or shows the target
    again."""
    target: Path | None = None
    """The file that holds the target; None where it is shown first."""
    save_target: Path | None = None
    """A new file to keep the target in that is shown; None where it is not kept."""
    teaching_frames: int = TEACHING_FRAMES
    """Frames that the target is the mean of."""


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
        "teaching_frames": job.teaching_frames,
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
