"""Taught poses on disk: target files as `--target` takes them, each with the picture at teaching.

The percent-encoded name of a pose is the name of its file. Every file therefore stays inside the
folder, and no two poses use the same file.
"""

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote, unquote

from rcmservo.config import target_file
from rcmservo.config.atomic_files import atomic_path
from rcmservo.config.target_file import TargetSetup
from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.interfaces import Target

MAX_FILE_NAME_BYTES = 200
"""Longest file name, without its suffix, in bytes."""

MAX_FILES = 200
"""Largest number of files that are read."""


@dataclass(frozen=True)
class PoseFolder:
    """Folder of taught poses and the setup that they belong to.

    Parameters
    ----------
    folder : Path
        Folder; it is created with the first pose.
    setup : TargetSetup
        Camera, arm, tool and markers with which the poses are taught.
    """

    folder: Path
    setup: TargetSetup


@dataclass
class PoseStore:
    """Taught poses of a folder. Call `load` first.

    Parameters
    ----------
    location : PoseFolder
        Folder and setup.
    targets : dict[str, Target]
        Targets that this setup can reach, by the names of the poses.
    refused : dict[str, str]
        Reasons by the names of the poses whose files cannot be used.
    """

    location: PoseFolder
    targets: dict[str, Target] = field(default_factory=dict[str, Target])
    refused: dict[str, str] = field(default_factory=dict[str, str])

    def load(self) -> None:
        """Read the folder. Refuse a file that is damaged or belongs to another setup."""
        for path in sorted(self.location.folder.glob("*.json"))[:MAX_FILES]:
            name = unquote(path.stem)
            try:
                self.targets[name] = target_file.load_target(path, self.location.setup)
            except RcmServoError as error:
                self.refused[name] = str(error).removeprefix(f"{path}: ")

    def save(self, name: str, target: Target, jpeg: bytes) -> str:
        """Store a pose with the JPEG file of a picture; replace a pose of the same name.

        If a file cannot be written, the pose exists until the page ends.

        Returns
        -------
        str
            Reason why the file was not written, or "".
        """
        self.targets[name] = target
        self.refused.pop(name, None)
        try:
            path = self._find_file(name)
            self.location.folder.mkdir(parents=True, exist_ok=True)
            target_file.save_target(path, target, self.location.setup)
            with atomic_path(path.with_suffix(".jpg")) as partial_file:
                partial_file.write_bytes(jpeg)
        except OSError as error:
            return f"{name} is not stored: {self.location.folder}: {error.strerror}"
        except RcmServoError as error:
            return f"{name} is not stored: {error}"
        return ""

    def delete(self, name: str) -> str:
        """Delete a pose and its files. Return the reason if a file cannot be deleted, or ""."""
        self.targets.pop(name, None)
        self.refused.pop(name, None)
        try:
            path = self._find_file(name)
            path.unlink(missing_ok=True)
            path.with_suffix(".jpg").unlink(missing_ok=True)
        except OSError as error:
            return f"{name} is not deleted: {error.strerror}"
        except UnusableFile:
            """The pose was never on disk."""
        return ""

    def read_picture(self, name: str) -> bytes:
        """Return the JPEG file of the picture at teaching; empty if there is none."""
        if name in self.targets or name in self.refused:
            with suppress(OSError, UnusableFile):
                return self._find_file(name).with_suffix(".jpg").read_bytes()
        return b""

    def _find_file(self, name: str) -> Path:
        encoded = quote(name, safe=" ")
        path = self.location.folder / f"{encoded}.json"
        if len(encoded) > MAX_FILE_NAME_BYTES:
            limit = f"{MAX_FILE_NAME_BYTES} bytes"
            raise UnusableFile(path, f"has a name longer than {limit}: shorten the pose's name")
        return path
