"""Uncalibrated visual servoing for remote-centre-of-motion (RCM) arms.

One fixed camera, which nobody has calibrated, watches two markers on a tool. The image Jacobian is
estimated while the tool moves, and the tool returns to a pose that it was taught once. The method
is that of the paper "Adaptive Image-based Positioning of RCM Mechanisms Using Angle and Distance
Features", to which equation and section numbers refer.

A simulated run::

    import rcmservo as rs

    rig = rs.sim.Rig(seed=0)
    target = rig.teach()
    result = rs.run(rig, rs.Servo(), target, record="runs/first")
    print(result)  # arrived, error 0.01 mm (bound 0.01), 2.3 s

Your own arm and camera, in wall time (docs/own_devices.md), or those of a rig file
(docs/live_on_hardware.md)::

    tracker, tool = rs.tracking.ColourMarkers(), rs.RigidTool(spacing=30.0)
    rig = rs.Rig(MyArm(), MyCamera(), tracker, rs.SphericalRcm(), tool)
    with rig:  # or rs.load_rig("lab.toml"): connects, and leaves the drive off
        target = rig.teach()
        input("Move the tool away, then press Enter")
        result = rs.run(rig, rs.Servo(), target, confirm=input)

Estimators compared in the same scenes (docs/studies.md)::

    study = rs.compare({"dlt": rs.DltEstimator(), "mine": MyEstimator()}, scenes=200)
    print(study)
    study.worst("mine").show()

``help(rs.NAME)`` describes each name:

- a run: `Rig`, `load_rig`, `run`, `RecordedResult`, `RunResult`, `FinalPose`, `DriveResponse`,
  `Settled`, `Target`, `Operator`
- a study: `compare`, `bound`
- the loop in the open: `Plant`, `teach`, `ticks`, `servo_ticks`, `Tick`, `State`, `Phase`, `Cause`
- settings: `Servo`, `SaturatedController`, `Exploration`, `ImagedRcm`, `Gate`, `Thresholds`,
  `SphericalRcm`, `PitchYawRcm`, `RigidTool`, `ScaledTool`, and the classes ending in Estimator
- own parts: `Arm`, `Camera`, `Tracker`, `Clock` (Protocols), `Estimator`, `Sample`,
  `FeatureVector`, and ``rs.testing``, which checks them
- packages: ``rs.sim`` (simulated laboratory), ``rs.tracking`` (images to markers:
  `ColourMarkers`, and `PointMarkers` for a camera that delivers points), ``rs.study`` (many runs),
  ``rs.hardware`` (drivers and emulators)

Lengths are in mm, image coordinates in px, angles in rad; pixel (0, 0) is the centre of the top
left pixel, u points right and v down. Row 0 of two markers is marker 1, the one nearer the RCM.
"Raw" pixels are image coordinates; m is relative to the imaged RCM o_c. y = [s r d] in rad, px, px
are the angle of the imaged tool, the distance of marker 1 from o_c and the distance between the
markers. docs/notation.md lists all symbols, docs/paper.md the equations and their files.

The public names are those of `rcmservo.public`, loaded on first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

from rcmservo.errors import require_extra

if TYPE_CHECKING:
    from rcmservo.public import *  # noqa: F403

__version__ = "0.2.0"

PUBLIC_PACKAGES = "hardware", "sim", "study", "testing", "tracking"
"""Packages that are public as they are. Some need MuJoCo, OpenCV or a driver's library, which the
core does not."""

STUDY_NAMES = "bound", "compare"
"""Public names of `rcmservo.study`, which are also loaded on first use."""


def __dir__() -> list[str]:
    """Return the public names."""
    public = importlib.import_module("rcmservo.public")
    return sorted([*public.__all__, *PUBLIC_PACKAGES, *STUDY_NAMES, "__version__"])


def __getattr__(name: str) -> Any:
    """Load a public name on first use, so that the command line starts quickly."""
    if name in PUBLIC_PACKAGES:
        with require_extra(f"rcmservo.{name}", "sim"):
            return importlib.import_module(f"rcmservo.{name}")
    if name in STUDY_NAMES:
        return getattr(importlib.import_module("rcmservo.study"), name)
    public = importlib.import_module("rcmservo.public")
    if name == "__all__":
        return [*public.__all__, *STUDY_NAMES]
    if name in public.__all__:
        return getattr(public, name)
    raise AttributeError(f"module 'rcmservo' has no attribute {name!r}")
