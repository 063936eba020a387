"""Import of user-defined classes, which are named as module:class.

The user consents to this code on the command line: by an option that names the class, or by --rig
with a rig file that names it. A record, target, study file or manifest never loads code.
"""

import importlib
import re
import sys
from pathlib import Path

from rcmservo.errors import BadInput, shorten_to_line

CLASS_PATH = re.compile(r"\w+(\.\w+)*:\w+")
"""Name of a user-defined class, as module:class."""


def import_user_object(name: str, field: str, folder: Path | None = None) -> object:
    """Import a module and return what it defines under a name, such as a class.

    The module is found on the Python path, in the current directory, or in `folder`.

    Parameters
    ----------
    name : str
        Name as module:class, which matches `CLASS_PATH`.
    field : str
        Option or key that gives the name, for error messages.
    folder : Path or None
        Another folder in which the module may be, such as that of the rig file.

    Returns
    -------
    object
        The named object; None if the module has none.

    Raises
    ------
    BadInput
        If the module cannot be imported.
    """
    module, _, object_name = name.partition(":")
    for path in (Path.cwd(), *([folder.resolve()] if folder else [])):
        if str(path) not in sys.path:
            sys.path.append(str(path))
    try:
        return getattr(importlib.import_module(module), object_name, None)
    except (Exception, SystemExit) as error:  # the code of the module may raise anything
        raised = f"{module} raised {shorten_to_line(repr(error))}"
        raise BadInput(field, name, f"a class of an importable module; {raised}") from error
