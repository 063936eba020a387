"""What to simulate, what to write, and what the record says of it."""

import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rcmservo.config.rig_file import Lab
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, RigSettings


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
