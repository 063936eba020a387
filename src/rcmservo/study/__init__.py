"""Many closed loops at once: the laboratory as compiled functions, the servo's step its own; and
the least error that any servo could leave in them."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rcmservo.study.batch import Study
    from rcmservo.study.course import StudyRun
    from rcmservo.study.cramer_rao import Bound, bound

__all__ = ["Bound", "Study", "StudyRun", "bound"]


def __getattr__(name: str) -> Any:
    """Load a public name on its first use: the conditions of a study need no simulation."""
    if name not in __all__:
        raise AttributeError(f"module 'rcmservo.study' has no attribute {name!r}")
    modules = ("batch", "course", "cramer_rao")
    found = (import_module(f"rcmservo.study.{module}") for module in modules)
    return next(getattr(module, name) for module in found if hasattr(module, name))
