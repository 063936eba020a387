"""Studies: many simulated closed loops of one servo, and the Cramér-Rao bound of their pose error.

`batch` runs the servo's live step on a compiled plant. `sim.cramer_rao` computes the smallest
error that an unbiased servo can reach in a scene. The public names are:

- ``Study(servo, settings, duration, teaching_frames)``: simulated closed loops of a servo, each
  ``duration`` s long (15 by default). The estimator of the servo must have a compiled step:
  `DltEstimator` or `ProjectionEstimator`. ``settings``, a ``rs.sim.RigSettings``, is the simulated
  laboratory, and ``teaching_frames`` (300 by default) the number of frames whose mean is the
  target. ``study.run(seed)`` runs the loop in the scene of
  ``rs.sim.Rig(seed)``, and ``study.runs(seeds)`` runs many on all processors.
- ``StudyRun``: the result of a loop. `error` (n,) is the true distance in mm of marker 2 from the
  target at every tick, `pose_error` its root mean square over the last second, `first_within(mm)`
  the time in s at which it is first that small, and `stops` the times and causes of all stops.
  `phases` and `causes` (n,) are indices in ``rcmservo.safety.state_machine.PHASES`` and
  ``rcmservo.safety.causes.CAUSES``.
- ``bound(scene, noise, frames, shown)``: the Cramér-Rao bound of the pose error,
  noise² (1/frames + 1/shown) (HᵀH)⁻¹, also available as ``rs.bound``. H (4, 3) px/mm is the
  derivative of both markers' pixels (u₁, v₁, u₂, v₂) with respect to the position of marker 2.
- ``Bound``: its result, with the `covariance` (3, 3) in mm² and the root mean square `rms` in mm.

For example, with ``rs`` the package `rcmservo`::

    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
    study = rs.study.Study(servo)
    errors_mm = [run.pose_error for run in study.runs(range(200))]

``help(rs.study.Study)`` shows the parameters of a class.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rcmservo.errors import require_extra

if TYPE_CHECKING:
    from rcmservo.sim.cramer_rao import Bound, bound
    from rcmservo.study.batch import Study
    from rcmservo.study.run_outcome import StudyRun

PUBLIC_MODULES = "rcmservo.study.batch", "rcmservo.sim.cramer_rao"
"""Modules that hold the public names."""
__all__ = ["Bound", "Study", "StudyRun", "bound"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use: the conditions of a study need no simulator."""
    if name not in __all__:
        raise AttributeError(f"module 'rcmservo.study' has no attribute {name!r}")
    with require_extra("rcmservo.study", "sim"):
        modules = list(map(import_module, PUBLIC_MODULES))
        return next(getattr(module, name) for module in modules if hasattr(module, name))
