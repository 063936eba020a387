"""A user's own module on its way to workers that do not have it: its source as a zip, by its hash.

A module in one file is sent with what it imports from its own folder, one in a package as the
package, .py files only. A worker imports it from there, whatever is installed under that name on
its machine, and another version of it anew.
"""

import hashlib
import importlib
import io
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from functools import cache
from modulefinder import ModuleFinder
from pathlib import Path
from sysconfig import get_path
from typing import Any, NamedTuple

from rcmservo.errors import RcmServoError, one_line
from rcmservo.estimation.base import Estimator
from rcmservo.servo.user_estimator import name_of_class

LARGEST = 10_000_000
"""Bytes of a parcel."""

STAMP = (1980, 1, 1, 0, 0, 0)
"""Of every file, so that the same source is the same parcel."""


class Parcel(NamedTuple):
    """A user's own module.

    Parameters
    ----------
    name : str
        The class that is needed, as module:class.
    data : bytes
        A zip of its source.
    digest : str
        Its SHA-256, in hexadecimal.
    """

    name: str = ""
    data: bytes = b""
    digest: str = ""


EMPTY = Parcel()


def parcel_of(kind: type[Estimator]) -> Parcel:
    """The parcel with the module of a class, which is imported here."""
    data, files = io.BytesIO(), dict(_files(kind.__module__))
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(files.items()):
            archive.writestr(zipfile.ZipInfo(name, STAMP), content)
    packed = data.getvalue()
    if len(packed) > LARGEST:
        raise RcmServoError(
            f"the source of {kind.__module__} is larger than {LARGEST} bytes, too large to be sent "
            "to workers"
        )
    return Parcel(name_of_class(kind), packed, hashlib.sha256(packed).hexdigest())


def _files(module: str) -> Iterable[tuple[str, bytes]]:
    """What a module consists of: its own file and what that imports from beside it, or all .py
    files of its package.
    """
    top = sys.modules[module.partition(".")[0]]
    places = list(getattr(top, "__path__", ()))
    if not places:
        path = Path(str(top.__file__))
        yield f"{top.__name__}.py", path.read_bytes()
        for other in _beside(path):
            yield other.relative_to(path.parent).as_posix(), other.read_bytes()
    for place in map(Path, places):
        for path in sorted(place.rglob("*.py")):
            yield f"{top.__name__}/{path.relative_to(place).as_posix()}", path.read_bytes()


def _beside(path: Path) -> list[Path]:
    """The files that a file imports from its own folder, and they from there; none of it where it
    is installed, as it then is installed on workers too.
    """
    folder = path.parent
    if folder in {Path(get_path(kind)) for kind in ("purelib", "platlib", "stdlib")}:
        return []
    finder: Any = ModuleFinder([str(folder)], excludes=["rcmservo"])
    finder.run_script(str(path))
    found = [Path(one.__file__) for one in finder.modules.values() if one.__file__]
    return [other for other in found if other.suffix == ".py" and other != path]


def classes(parcel: Parcel) -> dict[str, type[Estimator]]:
    """The class of a parcel by its name, module:class, from its own source."""
    if not parcel.name:
        return {}
    module, _, cls = parcel.name.partition(":")
    try:
        return {parcel.name: getattr(_imported(module, parcel.data, parcel.digest), cls)}
    except (Exception, SystemExit) as error:  # of whatever the module does while it is imported
        raise RcmServoError(
            f"{module} cannot be imported by a worker, where what it imports from elsewhere must "
            f"be installed: {one_line(error)}"
        ) from error


@cache
def _imported(module: str, data: bytes, digest: str) -> object:
    """A module from the source in a zip, instead of any that was imported by its names before."""
    if hashlib.sha256(data).hexdigest() != digest:
        raise RcmServoError("its hash is another one")
    path = Path(_folder().name) / f"{digest}.zip"
    path.write_bytes(data)
    with zipfile.ZipFile(path) as archive:
        tops = {name.partition("/")[0].removesuffix(".py") for name in archive.namelist()}
    for old in [name for name in sys.modules if name.partition(".")[0] in tops]:
        del sys.modules[old]
    sys.path.insert(0, str(path))  # for good: its functions may import more of it
    importlib.invalidate_caches()
    return importlib.import_module(module)


@cache
def _folder() -> "tempfile.TemporaryDirectory[str]":
    return tempfile.TemporaryDirectory(prefix="rcmservo-")
