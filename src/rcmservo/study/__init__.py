"""Studies: many simulated closed loops of one servo, and the Cramér-Rao bound of their pose error.

`batch` runs the servo's live step on a compiled plant. `cramer_rao` computes the smallest error
that an unbiased servo can reach in a scene.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rcmservo.errors import require_extra

if TYPE_CHECKING:
    from rcmservo.study.batch import Study
    from rcmservo.study.cramer_rao import Bound, bound
    from rcmservo.study.run_outcome import StudyRun

PUBLIC_MODULES = "batch", "cramer_rao"
"""Modules that hold the public names."""
__all__ = ["Bound", "Study", "StudyRun", "bound"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use: the conditions of a study need no simulator."""
    if name not in __all__:
        raise AttributeError(f"module 'rcmservo.study' has no attribute {name!r}")
    with require_extra("rcmservo.study", "sim"):
        modules = (import_module(f"rcmservo.study.{module}") for module in PUBLIC_MODULES)
        return next(getattr(module, name) for module in modules if hasattr(module, name))
