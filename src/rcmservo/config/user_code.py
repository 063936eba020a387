"""Code that is not ours, by its name module:class: it is run when a person names it on the command
line, and never because a file or record does.
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

OPTION = "--estimator"
NAME = re.compile(r"\w+(\.\w+)*:\w+")


def named(name: str, option: str = OPTION) -> type[Estimator]:
    """The estimator class that a person has named by an option; its module is imported, from the
    Python path or the present folder.
    """
    module, _, cls = name.partition(":")
    if not NAME.fullmatch(name):
        ours = ", ".join((*ESTIMATORS, *PRESETS))
        raise BadInput(option, name, f"one of {ours}, or module:class such as mylab.rls:RLS")
    kind: object = getattr(_imported(module, name, option), cls, None)
    if not (isinstance(kind, type) and issubclass(kind, Estimator)):
        raise BadInput(option, name, f"a class in {module} that derives from rcmservo.Estimator")
    if not is_dataclass(kind):
        raise BadInput(option, name, "a frozen dataclass, whose fields are its settings")
    if inspect.isabstract(kind):
        lacks = ", ".join(sorted(kind.__abstractmethods__))
        raise BadInput(option, name, f"an estimator with all its methods; it lacks {lacks}")
    _try(kind, name, option)
    return kind


def _try(kind: type[Estimator], name: str, option: str) -> None:
    """Refuse a class that cannot be made from its defaults."""
    try:
        kind()
    except RcmServoError:
        raise
    except Exception as error:
        right = f"a class whose settings all have a default; to make one raised {one_line(error)}"
        raise BadInput(option, name, right) from error


def _imported(module: str, name: str, option: str) -> object:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        return importlib.import_module(module)
    except (Exception, SystemExit) as error:  # of whatever the module does while it is imported
        right = f"a class of a module that can be imported; {module} raised {one_line(repr(error))}"
        raise BadInput(option, name, right) from error


def source(estimator: Estimator) -> str:
    """SHA-256 of the file that a user's own estimator comes from, in hexadecimal; empty for ours,
    and where there is no such file.
    """
    module = type(estimator).__module__
    file = getattr(sys.modules.get(module), "__file__", None)
    if module.startswith("rcmservo.") or file is None:
        return ""
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError:
        return ""
