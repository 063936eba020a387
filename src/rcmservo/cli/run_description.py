"""Description of a run in its record, in addition to its stages, which hold servo and target."""

import platform
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from rcmservo.cli.run_options import LabOptions

PACKAGES = "numpy", "numba", "opencv-python-headless"
"""Packages whose versions each record holds."""


def describe_run(options: LabOptions, duration: float, *packages: str) -> dict[str, Any]:
    """Return the description of a run, simulated or on hardware: settings and versions."""
    return {
        "duration_s": duration,
        "estimator": options.estimator,
        "mechanism": options.lab.mechanism.name,
        "teaching_frames": options.teaching_frames,
        "markers": asdict(options.lab.markers),
        "versions": {
            "rcmservo": version("rcmservo"),
            "python": platform.python_version(),
            **{name: version(name) for name in (*PACKAGES, *packages)},
        },
    }


def describe_simulated_run(options: LabOptions, duration: float) -> dict[str, Any]:
    """Return the description of a simulated run."""
    return {
        "simulation": True,
        "seed": options.seed,
        "disturbances": [],
        "resumes": 0,
        "rig": asdict(options.rig_settings),
        **describe_run(options, duration, "mujoco-core"),
    }
