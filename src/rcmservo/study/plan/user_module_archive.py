"""Archives of user modules for workers that do not have them: source as a zip, with its hash.

The archive of a one-file module also has the files that it imports from its own folder. The archive
of a module in a package has all .py files of the package. A worker imports the module from the
archive, even if its machine has another one of that name, and imports a changed archive again.
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

from rcmservo.errors import RcmServoError, shorten_to_line
from rcmservo.estimation.base import Estimator
from rcmservo.servo.user_estimator import format_class_name

MAX_ARCHIVE_BYTES = 10_000_000
"""Largest size of an archive, bytes."""

ZIP_TIMESTAMP = (1980, 1, 1, 0, 0, 0)
"""Time stamp of every file in an archive, so that equal sources give equal archives."""


class ModuleArchive(NamedTuple):
    """Source of the module of a user-defined estimator.

    Parameters
    ----------
    name : str
        Estimator class, as module:class.
    data : bytes
        Source as a zip file.
    digest : str
        SHA-256 of `data` in hexadecimal.
    """

    name: str = ""
    data: bytes = b""
    digest: str = ""


NO_ARCHIVE = ModuleArchive()


def archive_module(kind: type[Estimator]) -> ModuleArchive:
    """Return the archive with the module of an imported class."""
    data, files = io.BytesIO(), dict(_read_source_files(kind.__module__))
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(files.items()):
            archive.writestr(zipfile.ZipInfo(name, ZIP_TIMESTAMP), content)
    packed = data.getvalue()
    if len(packed) > MAX_ARCHIVE_BYTES:
        raise RcmServoError(
            f"the source of {kind.__module__} has {len(packed)} bytes as an archive; expected "
            f"at most {MAX_ARCHIVE_BYTES}: move the estimator to a smaller module"
        )
    return ModuleArchive(format_class_name(kind), packed, hashlib.sha256(packed).hexdigest())


def _read_source_files(module: str) -> Iterable[tuple[str, bytes]]:
    """Yield name and content of the files of a module.

    They are its file and the imports from its folder, or all .py files of its package.
    """
    top_module = sys.modules[module.partition(".")[0]]
    name, package_folders = top_module.__name__, list(getattr(top_module, "__path__", ()))
    if not package_folders:
        path = Path(str(top_module.__file__))
        yield f"{name}.py", path.read_bytes()
        for imported in _find_local_imports(path):
            yield imported.relative_to(path.parent).as_posix(), imported.read_bytes()
    for folder in map(Path, package_folders):
        for path in sorted(folder.rglob("*.py")):
            yield f"{name}/{path.relative_to(folder).as_posix()}", path.read_bytes()


def _find_local_imports(path: Path) -> list[Path]:
    """Return the files that a file imports, directly or indirectly, from its own folder.

    The list is empty for an installed module: its imports are installed on the workers too.
    """
    folder = path.parent
    if folder in {Path(get_path(kind)) for kind in ("purelib", "platlib", "stdlib")}:
        return []
    finder: Any = ModuleFinder([str(folder)], excludes=["rcmservo"])
    finder.run_script(str(path))
    imported = [Path(module.__file__) for module in finder.modules.values() if module.__file__]
    return [file for file in imported if file.suffix == ".py" and file != path]


def load_classes(archive: ModuleArchive) -> dict[str, type[Estimator]]:
    """Return the class of an archive by its name, module:class, imported from the archive."""
    if not archive.name:
        return {}
    module, _, class_name = archive.name.partition(":")
    try:
        imported = _import_from_archive(module, archive.data, archive.digest)
        return {archive.name: getattr(imported, class_name)}
    except (Exception, SystemExit) as error:  # the import runs the user's code
        raise RcmServoError(
            f"{module} cannot be imported by a worker: {shorten_to_line(error)}; install there "
            "what the module imports from outside its folder"
        ) from error


@cache
def _import_from_archive(module: str, data: bytes, digest: str) -> object:
    """Import a module from the source in a zip, in place of earlier imports of the same names."""
    if hashlib.sha256(data).hexdigest() != digest:
        raise RcmServoError(f"the SHA-256 of its archive is not {digest}: the transfer damaged it")
    path = Path(_make_archive_folder().name) / f"{digest}.zip"
    path.write_bytes(data)
    with zipfile.ZipFile(path) as archive:
        replaced = {name.partition("/")[0].removesuffix(".py") for name in archive.namelist()}
    for name in [name for name in sys.modules if name.partition(".")[0] in replaced]:
        del sys.modules[name]
    sys.path.insert(0, str(path))  # permanent: functions of the module may import more of it
    importlib.invalidate_caches()
    return importlib.import_module(module)


@cache
def _make_archive_folder() -> "tempfile.TemporaryDirectory[str]":
    """Return the folder of the archives of this process, which is deleted at its end."""
    return tempfile.TemporaryDirectory(prefix="rcmservo-")
