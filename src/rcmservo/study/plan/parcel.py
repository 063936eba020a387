"""A user's own module on its way to workers that do not have it: its source as a zip, by its hash.

A module in one file is sent as that file, one in a package as the package, its .py files only. A
worker imports it from there, whatever is installed under that name on its machine, and another
version of it anew.
"""

import hashlib
import importlib
import io
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

from rcmservo.errors import RcmServoError
from rcmservo.method.estimators.base import Estimator
from rcmservo.servo.own_estimator import name_of_class

LARGEST = 10_000_000
"""Bytes of a parcel."""

STAMP = (1980, 1, 1, 0, 0, 0)
"""Of every file, so that the same source is the same parcel."""


class Parcel(NamedTuple):
    """A user's own module."""

    name: str = ""
    """The class that is needed, as module:class."""
    data: bytes = b""
    """A zip of its source."""
    digest: str = ""
    """Its SHA-256, in hexadecimal."""


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
    """What a module consists of: its own file, or all .py files of its package."""
    top = sys.modules[module.partition(".")[0]]
    places = list(getattr(top, "__path__", ()))
    if not places:
        path = Path(str(top.__file__))
        yield f"{top.__name__}.py", path.read_bytes()
    for place in map(Path, places):
        for path in sorted(place.rglob("*.py")):
            yield f"{top.__name__}/{path.relative_to(place).as_posix()}", path.read_bytes()


@cache
def classes(parcel: Parcel) -> dict[str, type[Estimator]]:
    """The class of a parcel by its name, module:class, from its own source."""
    if not parcel.name:
        return {}
    if hashlib.sha256(parcel.data).hexdigest() != parcel.digest:
        raise RcmServoError("a user's module came damaged: its hash is another one")
    sys.path.insert(0, str(_laid_down(parcel)))  # for good: its functions may import more of it
    module, _, cls = parcel.name.partition(":")
    top = module.partition(".")[0]
    for old in [name for name in sys.modules if name == top or name.startswith(f"{top}.")]:
        del sys.modules[old]
    importlib.invalidate_caches()
    return {parcel.name: getattr(importlib.import_module(module), cls)}


def _laid_down(parcel: Parcel) -> Path:
    """The zip as a file of this process's own, until it ends."""
    path = Path(_folder().name) / f"{parcel.digest}.zip"
    path.write_bytes(parcel.data)
    return path


@cache
def _folder() -> "tempfile.TemporaryDirectory[str]":
    return tempfile.TemporaryDirectory(prefix="rcmservo-")
