"""Description of a run that its record stores: settings, seed and versions of packages.

The servo and the target are not part of it; the record stores them for each stage of the run.
"""

import platform
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from rcmservo.cli.run_options import LabOptions

PACKAGES = "numpy", "numba", "opencv-python-headless"
"""Packages whose versions each record stores."""


def describe_run(options: LabOptions, duration_s: float, *packages: str) -> dict[str, Any]:
    """Return the description of a run, simulated or on hardware; `packages` adds versions."""
    return {
        "duration_s": duration_s,
        "estimator": options.estimator,
        "mechanism": options.lab.mechanism.name,
        "teaching_frames": options.teaching_frames,
        "markers": asdict(options.lab.markers),
        **{name: table for name, table in options.lab.devices.items() if name == "tracker"},
        "versions": {
            "rcmservo": version("rcmservo"),
            "python": platform.python_version(),
            **{name: version(name) for name in (*PACKAGES, *packages)},
        },
    }


def describe_simulated_run(options: LabOptions, duration_s: float) -> dict[str, Any]:
    """Return the description of a simulated run."""
    return {
        "simulation": True,
        "seed": options.seed,
        "disturbances": [],
        "resumes": 0,
        "rig": asdict(options.rig_settings),
        **describe_run(options, duration_s, "mujoco-core"),
    }
