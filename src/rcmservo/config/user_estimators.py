"""Import of user-defined estimators by their names module:class.

The code runs only if the user names it on the command line, never because a file or record does.
"""

import hashlib
import importlib
import inspect
import re
import sys
from dataclasses import is_dataclass
from pathlib import Path

from rcmservo.config.registry import ESTIMATORS, PRESETS
from rcmservo.errors import BadInput, RcmServoError, one_line
from rcmservo.estimation.base import Estimator

ESTIMATOR_OPTION = "--estimator"
CLASS_NAME = re.compile(r"\w+(\.\w+)*:\w+")


def import_estimator(name: str, option: str = ESTIMATOR_OPTION) -> type[Estimator]:
    """Import and return the estimator class that the user named by an option.

    The module is found on the Python path or in the current directory.

    Parameters
    ----------
    name : str
        Name of the class as module:class.
    option : str
        Option of the command line, for error messages.

    Raises
    ------
    BadInput
        If the module cannot be imported, or the class is no usable estimator.
    """
    module, _, cls = name.partition(":")
    if not CLASS_NAME.fullmatch(name):
        built_in = ", ".join((*ESTIMATORS, *PRESETS))
        raise BadInput(option, name, f"one of {built_in}, or module:class such as mylab.rls:RLS")
    kind: object = getattr(_import_module(module, name, option), cls, None)
    if not (isinstance(kind, type) and issubclass(kind, Estimator)):
        raise BadInput(option, name, f"a class in {module} that derives from rcmservo.Estimator")
    if not is_dataclass(kind):
        raise BadInput(option, name, "a frozen dataclass, whose fields are its settings")
    if inspect.isabstract(kind):
        missing = ", ".join(sorted(kind.__abstractmethods__))
        raise BadInput(option, name, f"an estimator with all its methods; it lacks {missing}")
    _require_defaults(kind, name, option)
    return kind


def _require_defaults(kind: type[Estimator], name: str, option: str) -> None:
    """Raise `BadInput` if the class cannot be constructed with its defaults."""
    try:
        kind()
    except RcmServoError:
        raise
    except Exception as error:
        expected = f"a class whose settings all have a default; it raised {one_line(error)}"
        raise BadInput(option, name, expected) from error


def _import_module(module: str, name: str, option: str) -> object:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        return importlib.import_module(module)
    except (Exception, SystemExit) as error:  # from the code of the module
        raised = f"{module} raised {one_line(repr(error))}"
        raise BadInput(option, name, f"a class of an importable module; {raised}") from error


def hash_source(estimator: Estimator) -> str:
    """Return the SHA-256 of a user-defined estimator's source file in hexadecimal.

    The result is empty for a built-in estimator, or if there is no such file.
    """
    module = type(estimator).__module__
    file = getattr(sys.modules.get(module), "__file__", None)
    if module.startswith("rcmservo.") or file is None:
        return ""
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError:
        return ""
