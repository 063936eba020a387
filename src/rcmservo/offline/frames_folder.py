"""A folder of frames with the joints at each: what a recording of a real arm is, and what `export`
makes.

    poses.csv      frame, three joint columns (rad, rad, m); where known x_m, y_m, z_m, time_s
    frames/NN.jpg  or .png, one for every row

x_m, y_m, z_m is the tool's reference point as the arm's own kinematics give it; where it is there,
it rules over the joints in the last digits. time_s is the moment of the exposure; without it the
poses are taken for stills.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rcmservo.errors import BadInput, UnusableFile
from rcmservo.interfaces import Floats, Frame
from rcmservo.method.kinematics import Kinematics
from rcmservo.method.tool import Tool
from rcmservo.tracking import read_image

JOINT_COLUMNS = {
    "spherical": ("theta_rad", "phi_rad", "rho_m"),
    "pitch-yaw": ("yaw_rad", "pitch_rad", "insertion_m"),
}
POSITION_COLUMNS = ("x_m", "y_m", "z_m")
METRES = np.array([1.0, 1.0, 1e-3])
AGREEMENT = 1.0
"""mm by which the joints' position and x_m, y_m, z_m may differ before the description of the arm
must be wrong."""


@dataclass(frozen=True, eq=False)
class Pose:
    """One row: the frame's name and file, joints q (3,), p₁ (3,) mm of marker 1, and the exposure
    in s, or None."""

    name: str
    file: Path
    q: Floats
    p1: Floats
    time: float | None


def load(folder: Path, mechanism: Kinematics, tool: Tool) -> list[Pose]:
    """All poses of a recording, every row checked, in the order of the file."""
    table = folder / "poses.csv"
    if not folder.is_dir():
        raise UnusableFile(folder, "is not a folder with frames/ and poses.csv")
    if not table.is_file():
        raise UnusableFile(table, "is missing: it gives the joints at every frame")
    files = {
        file.stem: file
        for file in sorted((folder / "frames").glob("*"))
        if file.suffix in (".jpg", ".png")
    }
    if not files:
        raise UnusableFile(folder / "frames", "holds no frames (NN.jpg or NN.png)")
    poses = [_pose(table, row, files, mechanism, tool) for row in _rows(table, mechanism)]
    names = [pose.name for pose in poses]
    for name in files:
        if name not in names:
            raise UnusableFile(table, f"has no row for frame {name}")
    if len(set(names)) < len(names):
        raise UnusableFile(table, "has two rows for one frame")
    return poses


def frames(poses: list[Pose]) -> Iterator[Frame]:
    """The frames of a recording, one at a time."""
    for number, pose in enumerate(poses):
        exposure = round((pose.time or 0.0) * 1e9)
        yield Frame(number, exposure, exposure, image=read_image(pose.file))


def _rows(table: Path, mechanism: Kinematics) -> list[dict[str, str]]:
    try:
        with table.open(newline="") as file:
            reader = csv.DictReader(file, restval="")
            columns = reader.fieldnames or []
            for column in ("frame", *JOINT_COLUMNS[mechanism.name]):
                if column not in columns:
                    raise UnusableFile(
                        table, f"has no column {column}, which a {mechanism.name} mechanism needs"
                    )
            return list(reader)
    except OSError as error:
        raise UnusableFile(table, f"cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UnusableFile(table, "is not a table of comma-separated text") from error


def _pose(
    table: Path, row: dict[str, str], files: dict[str, Path], mechanism: Kinematics, tool: Tool
) -> Pose:
    name = row["frame"]
    if name not in files:
        raise UnusableFile(table, f"has a row for frame {name!r}, but frames/ has no such picture")
    q = _numbers(table, row, JOINT_COLUMNS[mechanism.name]) / METRES
    p = mechanism.position(q)
    if POSITION_COLUMNS[0] in row:
        given = _numbers(table, row, POSITION_COLUMNS) * 1e3
        apart = float(np.linalg.norm(given - p))
        if apart > AGREEMENT:
            right = f"within {AGREEMENT:g} mm of what the joints give"
            raise BadInput(f"{table}: frame {name}: x_m, y_m, z_m", f"{apart:.1f} mm away", right)
        p = given
    n = p / np.linalg.norm(p)
    time = float(_numbers(table, row, ("time_s",))[0]) if "time_s" in row else None
    return Pose(name, files[name], q, p + tool.offset * n, time)


def _numbers(table: Path, row: dict[str, str], columns: tuple[str, ...]) -> Floats:
    values = np.empty(len(columns))
    for i, column in enumerate(columns):
        text = row.get(column) or ""
        try:
            values[i] = float(text)
        except ValueError:
            values[i] = np.nan
        if not np.isfinite(values[i]):
            raise BadInput(f"{table}: frame {row['frame']}: {column}", text, "a finite number")
    return values


class RecordingWriter:
    """Writes frames and joints as a folder that `load` reads; rows appear only after their frame is
    whole."""

    def __init__(self, folder: Path, mechanism: Kinematics) -> None:
        self._folder, self._mechanism, self._count = folder, mechanism, 0
        (folder / "frames").mkdir(parents=True)
        columns = ("frame", *JOINT_COLUMNS[mechanism.name], *POSITION_COLUMNS, "time_s")
        (folder / "poses.csv").write_text(",".join(columns) + "\n")

    def write(self, jpeg: bytes, q: Floats, exposure: int) -> None:
        """Add one picture as a JPEG file, the joints q (3,) at its exposure, and that moment in
        ns."""
        name = f"{self._count:05d}"
        (self._folder / "frames" / f"{name}.jpg").write_bytes(jpeg)
        numbers = np.concatenate([q * METRES, self._mechanism.position(q) * 1e-3])
        row = [name, *(f"{number:.9g}" for number in numbers), f"{exposure * 1e-9:.9f}"]
        with (self._folder / "poses.csv").open("a") as file:
            file.write(",".join(row) + "\n")
        self._count += 1
