"""A recording: a folder of frames with the joints at each, of a real arm or as `export` makes it.

    poses.csv      frame, three joint columns (rad, rad, m); where known x_m, y_m, z_m, time_s
    frames/NN.jpg  or .png, one for every row

x_m, y_m, z_m is the tool's reference point as the arm's own kinematics give it; where it is there,
it rules over the joints in the last digits. time_s is the moment of the exposure; without it the
poses are taken for stills.

A recording of points has no pictures, but the markers in poses.csv: m1_u_px, m1_v_px, m2_u_px,
m2_v_px, where both cells of a marker that was not seen are empty.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rcmservo.errors import BadInput, UnusableFile
from rcmservo.interfaces import Floats, Frame
from rcmservo.method.kinematics import Kinematics
from rcmservo.method.tool import Tool
from rcmservo.offline.table import Table, TableRow, read_table
from rcmservo.offline.units import METRES, joints
from rcmservo.tracking import read_image

JOINT_COLUMNS = {
    "spherical": ("theta_rad", "phi_rad", "rho_m"),
    "pitch-yaw": ("yaw_rad", "pitch_rad", "insertion_m"),
}
POSITION_COLUMNS = ("x_m", "y_m", "z_m")
POINT_COLUMNS = ("m1_u_px", "m1_v_px", "m2_u_px", "m2_v_px")
PICTURES = (".jpg", ".jpeg", ".png")
AGREEMENT = 1.0
"""mm by which the joints' position and x_m, y_m, z_m may differ before the description of the arm
must be wrong."""


@dataclass(frozen=True, eq=False)
class Pose:
    """One frame of a recording, and where the tool was."""

    name: str
    """The frame's, as poses.csv has it; its picture's too, without the ending."""
    picture: Path | None
    """Its file, or None in a recording of points."""
    points: Floats | None
    """The markers (2, 2) px, NaN where not seen, or None where there is a picture."""
    q: Floats
    """The joints (3,) rad, rad, mm."""
    p1: Floats
    """p₁ (3,) mm of marker 1."""
    time: float | None
    """The moment of the exposure in s, if it is known."""


def load(folder: Path, mechanism: Kinematics, tool: Tool) -> list[Pose]:
    """All poses of a recording, every row checked, in the order of the table."""
    table = _table(folder, mechanism)
    names = [row.cells["frame"] for row in table.rows]
    if len(set(names)) < len(names):
        raise UnusableFile(table.path, "has two rows for one frame")
    files = {} if POINT_COLUMNS[0] in table.titles else _pictures(folder, table.path, names)
    q = joints(table, JOINT_COLUMNS[mechanism.name], mechanism.limits)
    return [
        _pose(row, files.get(row.cells["frame"]), q[i], mechanism, tool)
        for i, row in enumerate(table.rows)
    ]


def frames(poses: list[Pose]) -> Iterator[Frame]:
    """The frames of a recording, one at a time."""
    for number, pose in enumerate(poses):
        exposure = round((pose.time or 0.0) * 1e9)
        image = None if pose.picture is None else read_image(pose.picture)
        yield Frame(number, exposure, exposure, image=image, points=pose.points)


def _table(folder: Path, mechanism: Kinematics) -> Table:
    """poses.csv with all columns that it needs."""
    path = folder / "poses.csv"
    if not folder.is_dir():
        raise UnusableFile(folder, "is not a folder with frames/ and poses.csv")
    if not path.is_file():
        raise UnusableFile(path, "is missing: it gives the joints at every frame")
    table = read_table(path, "frame")
    table.require(("frame", *JOINT_COLUMNS[mechanism.name]), f"a {mechanism.name} mechanism")
    for group, needs in (
        (POINT_COLUMNS, "a recording of points"),
        (POSITION_COLUMNS, "a position"),
    ):
        if group[0] in table.titles:
            table.require(group, needs)
    return table


def _pictures(folder: Path, table: Path, names: list[str]) -> dict[str, Path]:
    """The picture of every frame, each with its row in the table."""
    files = {
        file.stem: file
        for file in sorted((folder / "frames").glob("[!.]*"))
        if file.suffix.lower() in PICTURES
    }
    if not files:
        points = ", ".join(POINT_COLUMNS)
        why = f"holds no frames (NN.jpg or NN.png), and poses.csv no points ({points})"
        raise UnusableFile(folder / "frames", why)
    for name in sorted(files.keys() - set(names)):
        raise UnusableFile(table, f"has no row for frame {name}")
    for name in names:
        if name not in files:
            why = f"has a row for frame {name!r}, but frames/ has no such picture"
            raise UnusableFile(table, why)
    return files


def _pose(
    row: TableRow, picture: Path | None, q: Floats, mechanism: Kinematics, tool: Tool
) -> Pose:
    p = _reference(row, mechanism.position(q))
    p1 = p + tool.offset * p / np.linalg.norm(p)
    points = None if picture else _points(row)
    time = float(row.numbers(("time_s",))[0]) if "time_s" in row.cells else None
    return Pose(row.cells["frame"], picture, points, q, p1, time)


def _points(row: TableRow) -> Floats:
    return np.array([row.numbers_or_none(POINT_COLUMNS[i : i + 2]) for i in (0, 2)])


def _reference(row: TableRow, p: Floats) -> Floats:
    """The reference point (3,) mm as the row gives it, or else p as its joints do."""
    if POSITION_COLUMNS[0] not in row.cells:
        return p
    given = row.numbers(POSITION_COLUMNS) * 1e3
    apart = float(np.linalg.norm(given - p))
    if not apart <= AGREEMENT:
        likely = np.linalg.norm(given * 1e-3 - p) <= AGREEMENT
        hint = " (this looks like mm)" if likely else ""
        right = f"within {AGREEMENT:g} mm of what the joints give{hint}"
        raise BadInput(f"{row.place}: x_m, y_m, z_m", f"{apart:.1f} mm away", right)
    return given


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
