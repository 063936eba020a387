"""Description of a run that its record stores: settings, seed and versions of packages.

The servo and the target are not part of it; the record stores them for each stage of the run.
"""

from dataclasses import asdict
from typing import Any

from rcmservo.cli.run_options import LabOptions
from rcmservo.rig.run import list_versions


def describe_run(options: LabOptions, duration_s: float, *packages: str) -> dict[str, Any]:
    """Return the description of a run, simulated or on hardware; `packages` adds versions."""
    return {
        "duration_s": duration_s,
        "estimator": options.estimator,
        "mechanism": options.lab.mechanism.name,
        "teaching_frames": options.teaching_frames,
        "markers": asdict(options.lab.markers),
        **{name: table for name, table in options.lab.devices.items() if name == "tracker"},
        "versions": list_versions(*packages),
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
