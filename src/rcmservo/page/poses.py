"""Poses on disk: the targets that a person has taught by their names, in the files that `--target`
takes, each with the picture that was seen then.

A pose's name is that of its file, percent-encoded, so that any name stays inside the folder and no
two share a file.
"""

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote, unquote

from rcmservo.config import target_file
from rcmservo.config.atomic_files import whole
from rcmservo.config.target_file import Setup
from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.interfaces import Target

MAX_FILE_NAME_BYTES = 200
"""Bytes of a file's name without its ending."""

MAX_FILES = 200
"""Files of a folder that are looked at."""


@dataclass(frozen=True)
class PoseFolder:
    """Where poses are, and what they are bound to.

    Parameters
    ----------
    folder : Path
        It is made for the first pose.
    setup : Setup
        The camera, arm, tool and markers that see them.
    """

    folder: Path
    setup: Setup


@dataclass
class PoseStore:
    """The poses of a folder; `read` begins.

    Parameters
    ----------
    of : PoseFolder
        Where they are.
    targets : dict[str, Target]
        Those that this setup can go to, by their names.
    refused : dict[str, str]
        Those that it cannot, and why.
    """

    location: PoseFolder
    targets: dict[str, Target] = field(default_factory=dict[str, Target])
    refused: dict[str, str] = field(default_factory=dict[str, str])

    def load(self) -> None:
        """Take what is there. A file that is damaged, or another setup's, is refused."""
        for path in sorted(self.location.folder.glob("*.json"))[:MAX_FILES]:
            name = unquote(path.stem)
            try:
                self.targets[name] = target_file.load(path, self.location.setup)
            except RcmServoError as error:
                self.refused[name] = str(error).removeprefix(f"{path}: ")

    def save(self, name: str, target: Target, jpeg: bytes) -> str:
        """Keep a pose, in the place of one of the same name. Why its file could not be written, in
        which case it is there until the page ends; empty where it was.
        """
        self.targets[name] = target
        self.refused.pop(name, None)
        try:
            path = self._file(name)
            self.location.folder.mkdir(parents=True, exist_ok=True)
            target_file.save(path, target, self.location.setup)
            with whole(path.with_suffix(".jpg")) as part:
                part.write_bytes(jpeg)
        except OSError as error:
            return f"{name} is not kept: {self.location.folder}: {error.strerror}"
        except RcmServoError as error:
            return f"{name} is not kept: {error}"
        return ""

    def delete(self, name: str) -> str:
        """Forget a pose, and remove its files; why that could not be, empty where it could."""
        self.targets.pop(name, None)
        self.refused.pop(name, None)
        try:
            path = self._file(name)
            for one in (path, path.with_suffix(".jpg")):
                one.unlink(missing_ok=True)
        except OSError as error:
            return f"{name} is not deleted: {error.strerror}"
        except UnusableFile:
            """It was never on disk."""
        return ""

    def picture(self, name: str) -> bytes:
        """The JPEG file of what was seen; empty where there is none."""
        if name in self.targets or name in self.refused:
            with suppress(OSError, UnusableFile):
                return self._file(name).with_suffix(".jpg").read_bytes()
        return b""

    def _file(self, name: str) -> Path:
        encoded = quote(name, safe=" ")
        path = self.location.folder / f"{encoded}.json"
        if len(encoded) > MAX_FILE_NAME_BYTES:
            raise UnusableFile(path, "has too long a name: shorten the pose's")
        return path
