"""Many closed loops at once: the laboratory as compiled functions, the servo's step its own; and
the least error that any servo could leave in them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rcmservo.errors import needing

if TYPE_CHECKING:
    from rcmservo.study.batch import Study
    from rcmservo.study.cramer_rao import Bound, bound
    from rcmservo.study.run_outcome import StudyRun

MODULES = "batch", "course", "cramer_rao"
"""Modules with the public names."""
__all__ = ["Bound", "Study", "StudyRun", "bound"]


def __getattr__(name: str) -> Any:
    """Load a public name on its first use: the conditions of a study need no simulation."""
    if name not in __all__:
        raise AttributeError(f"module 'rcmservo.study' has no attribute {name!r}")
    with needing("rcmservo.study", "sim"):
        modules = (import_module(f"rcmservo.study.{one}") for one in MODULES)
        return next(getattr(module, name) for module in modules if hasattr(module, name))
