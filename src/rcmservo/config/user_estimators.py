"""Import of user-defined estimators, which are named as module:class.

Their code runs only if the command line names it, never because a file or record does.
"""

import hashlib
import inspect
import sys
from dataclasses import is_dataclass
from pathlib import Path

from rcmservo.config.class_registry import ESTIMATORS, PRESETS
from rcmservo.config.user_classes import CLASS_PATH, import_user_object
from rcmservo.errors import BadInput, RcmServoError, shorten_to_line
from rcmservo.estimation.base import Estimator

ESTIMATOR_OPTION = "--estimator"


def import_estimator(name: str, option: str = ESTIMATOR_OPTION) -> type[Estimator]:
    """Import and return the estimator class that the user named by an option.

    The module is found on the Python path or in the current directory.

    Parameters
    ----------
    name : str
        Name of the class as module:class.
    option : str
        Option of the command line, for error messages.

    Returns
    -------
    type[Estimator]
        Class of the estimator, a dataclass whose settings all have a default.

    Raises
    ------
    BadInput
        If the module cannot be imported, or the class is no usable estimator.
    """
    if not CLASS_PATH.fullmatch(name):
        built_in = ", ".join((*ESTIMATORS, *PRESETS))
        raise BadInput(option, name, f"one of {built_in}, or module:class such as mylab.rls:RLS")
    found, module = import_user_object(name, option), name.partition(":")[0]
    if not (isinstance(found, type) and issubclass(found, Estimator)):
        raise BadInput(option, name, f"a class in {module} that derives from rcmservo.Estimator")
    if not is_dataclass(found):
        raise BadInput(option, name, "a frozen dataclass, whose fields are its settings")
    if inspect.isabstract(found):
        missing = ", ".join(sorted(found.__abstractmethods__))
        raise BadInput(option, name, f"an estimator with all its methods; it lacks {missing}")
    _require_defaults(found, name, option)
    return found


def _require_defaults(estimator_class: type[Estimator], name: str, option: str) -> None:
    """Raise `BadInput` if the class cannot be constructed with its defaults."""
    try:
        estimator_class()
    except RcmServoError:
        raise
    except Exception as error:
        expected = f"a class whose settings all have a default; it raised {shorten_to_line(error)}"
        raise BadInput(option, name, expected) from error


def hash_source(estimator: Estimator) -> str:
    """Return the SHA-256 of a user-defined estimator's source file in hexadecimal.

    The result is empty for a built-in estimator, or if there is no such file.
    """
    module = type(estimator).__module__
    source_file = getattr(sys.modules.get(module), "__file__", None)
    if module.startswith("rcmservo.") or source_file is None:
        return ""
    try:
        return hashlib.sha256(Path(source_file).read_bytes()).hexdigest()
    except OSError:
        return ""
