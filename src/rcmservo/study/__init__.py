"""Studies: many simulated closed loops of several methods, and the bound of their pose error.

`method_comparison` compares methods in the same scenes. `compiled_engine` runs a servo's live step
on a compiled plant, `simulation_engine` any servo in the full simulator. `sim.cramer_rao` computes
the smallest error that an unbiased servo can reach in a scene. The public names are:

- ``compare(methods, scenes, settings, duration, workers)``, also available as ``rs.compare``:
  methods compared in the same simulated scenes. ``methods`` maps names to estimators or servos,
  built-in or your own; ``scenes`` (200 by default) is their number, or a sequence of seeds, each
  that of ``rs.sim.Rig(seed)``. ``help(rs.compare)`` shows the other parameters.
- ``MethodComparison``: its result. ``print`` shows a table with 95 % confidence intervals; `rows`
  are the numbers of every run, `to_pandas()` returns them as a table, `plot()` draws a figure,
  ``run(name, seed)`` opens a run, and ``worst(name)`` that with the largest pose error.
- ``ComparedRun``: such a run, with its `seed`, `error` (mm) and `cause`. `show()` prints it and
  draws its error over time; `outcome` is its `StudyRun`, from a second run of the same seed.
- ``StudyRun``: the result of a loop. `error` (n,) is the true distance in mm of marker 2 from the
  target at every tick, `pose_error` its root mean square over the last second, `first_within(mm)`
  the time in s at which it is first that small, and `stops` the times and causes of all stops.
  `phases` and `causes` (n,) are indices in ``rcmservo.safety.state_machine.PHASES`` and
  ``rcmservo.safety.causes.CAUSES``.
- ``bound(scene, noise, frames, shown)``: the Cramér-Rao bound of the pose error,
  noise² (1/frames + 1/shown) (HᵀH)⁻¹, also available as ``rs.bound``. H (4, 3) px/mm is the
  derivative of both markers' pixels (u₁, v₁, u₂, v₂) with respect to the position of marker 2.
- ``Bound``: its result, with the `covariance` (3, 3) in mm² and the root mean square `rms` in mm.

For example, with ``rs`` the package `rcmservo` and ``MyEstimator`` an estimator of your own::

    study = rs.compare({"dlt": rs.DltEstimator(), "mine": MyEstimator()}, scenes=200)
    print(study)
    study.worst("mine").show()
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rcmservo.errors import require_extra

if TYPE_CHECKING:
    from rcmservo.sim.cramer_rao import Bound, bound
    from rcmservo.study.comparison import ComparedRun, MethodComparison
    from rcmservo.study.method_comparison import compare
    from rcmservo.study.run_outcome import StudyRun

PUBLIC_MODULES = {
    "Bound": "sim.cramer_rao",
    "ComparedRun": "study.comparison",
    "MethodComparison": "study.comparison",
    "StudyRun": "study.run_outcome",
    "bound": "sim.cramer_rao",
    "compare": "study.method_comparison",
}
"""Module of each public name."""
__all__ = ["Bound", "ComparedRun", "MethodComparison", "StudyRun", "bound", "compare"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use: the conditions of a study need no simulator."""
    if name not in __all__:
        raise AttributeError(f"module 'rcmservo.study' has no attribute {name!r}")
    with require_extra("rcmservo.study", "sim"):
        return getattr(import_module(f"rcmservo.{PUBLIC_MODULES[name]}"), name)
