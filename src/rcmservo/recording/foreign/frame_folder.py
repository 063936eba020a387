"""Reader and writer of recordings of any robot: folders with images and the joints at each image.

    poses.csv      frame, three joint columns (rad, rad, m); if known x_m, y_m, z_m, time_s
    frames/NN.jpg  or .png, one for each row

x_m, y_m, z_m is the tool's reference point as the arm's own kinematics give it. It replaces the
position computed from the joints, which must agree with it within 1 mm. time_s is the time of the
exposure; without it the frames count as single images of a tool at rest.

A recording of points has no images. Its poses.csv holds the markers in m1_u_px, m1_v_px, m2_u_px,
m2_v_px; both cells of an undetected marker are empty.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rcmservo.errors import BadInput, UnusableFile
from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats, Frame
from rcmservo.recording.foreign.pose_table import Table, TableRow, read_table
from rcmservo.recording.foreign.unit_checks import TO_RECORDED_UNITS, read_joints
from rcmservo.tracking import read_image

JOINT_COLUMNS = {
    "spherical": ("theta_rad", "phi_rad", "rho_m"),
    "pitch-yaw": ("yaw_rad", "pitch_rad", "insertion_m"),
}
"""Titles of the joint columns of each mechanism."""
POSITION_COLUMNS = ("x_m", "y_m", "z_m")
"""Titles of the columns with the tool's reference point."""
POINT_COLUMNS = ("m1_u_px", "m1_v_px", "m2_u_px", "m2_v_px")
"""Titles of the columns with the markers in a recording of points."""
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MAX_POSITION_MISMATCH_MM = 1.0
"""Largest distance in mm between x_m, y_m, z_m and the position computed from the joints. A larger
one means that the description of the arm does not match the recording."""


@dataclass(frozen=True, eq=False)
class RecordedPose:
    """Frame of a recording with the pose of the tool.

    Parameters
    ----------
    name : str
        Name of the frame in poses.csv, which is also the stem of its image file.
    image_path : Path or None
        Image file, or None in a recording of points.
    points : Floats or None
        Markers (2, 2) px, NaN for an undetected one; None if there is an image.
    q : Floats
        Joints (3,) in rad, rad, mm.
    p1 : Floats
        Position p₁ (3,) of marker 1 in mm.
    time : float or None
        Time of the exposure in s, or None if unknown.
    """

    name: str
    image_path: Path | None
    points: Floats | None
    q: Floats
    p1: Floats
    time: float | None


def load_recording(folder: Path, mechanism: Kinematics, tool: Tool) -> list[RecordedPose]:
    """Read and check all poses of a recording, in the order of the table.

    Parameters
    ----------
    folder : Path
        Folder with poses.csv and, for a recording of images, frames/.
    mechanism : Kinematics
        Mechanism of the arm; its name selects the joint columns.
    tool : Tool
        Tool, for the distance from the reference point to marker 1.

    Raises
    ------
    UnusableFile
        If a file, column, row or image is missing, or if a frame has two rows.
    BadInput
        If a value is no finite number, lies outside the rig's limits or contradicts the joints.
    """
    table = _read_poses(folder, mechanism)
    names = [row.cells["frame"] for row in table.rows]
    if len(set(names)) < len(names):
        raise UnusableFile(table.path, "has two rows for one frame")
    has_points = POINT_COLUMNS[0] in table.titles
    images = {} if has_points else _find_images(folder, table.path, names)
    joints = read_joints(table, JOINT_COLUMNS[mechanism.name], mechanism.limits)
    return [
        _read_pose(row, images.get(name), q, mechanism, tool)
        for row, name, q in zip(table.rows, names, joints, strict=True)
    ]


def iterate_frames(poses: list[RecordedPose]) -> Iterator[Frame]:
    """Yield the frames of a recording."""
    for number, pose in enumerate(poses):
        exposure = round((pose.time or 0.0) * 1e9)
        image = None if pose.image_path is None else read_image(pose.image_path)
        yield Frame(number, exposure, exposure, image=image, points=pose.points)


def _read_poses(folder: Path, mechanism: Kinematics) -> Table:
    """Return poses.csv, or raise ``UnusableFile`` if a required column is missing."""
    path = folder / "poses.csv"
    if not folder.is_dir():
        raise UnusableFile(folder, "is not a folder with frames/ and poses.csv")
    if not path.is_file():
        raise UnusableFile(path, "is missing; expected the joints at every frame")
    table = read_table(path, "frame")
    table.require(("frame", *JOINT_COLUMNS[mechanism.name]), f"a {mechanism.name} mechanism")
    for columns, purpose in (
        (POINT_COLUMNS, "a recording of points"),
        (POSITION_COLUMNS, "a position"),
    ):
        if columns[0] in table.titles:
            table.require(columns, purpose)
    return table


def _find_images(folder: Path, table: Path, names: list[str]) -> dict[str, Path]:
    """Return the image file of each frame; each must have a row in the table."""
    files = {
        file.stem: file
        for file in sorted((folder / "frames").glob("[!.]*"))
        if file.suffix.lower() in IMAGE_SUFFIXES
    }
    if not files:
        points = ", ".join(POINT_COLUMNS)
        reason = f"holds no images (NN.jpg or NN.png), and poses.csv holds no points ({points})"
        raise UnusableFile(folder / "frames", reason)
    for name in sorted(files.keys() - set(names)):
        raise UnusableFile(table, f"has no row for frame {name}")
    for name in (name for name in names if name not in files):
        reason = f"has a row for frame {name!r}, but frames/ has no such image"
        raise UnusableFile(table, reason)
    return files


def _read_pose(
    row: TableRow, image_path: Path | None, q: Floats, mechanism: Kinematics, tool: Tool
) -> RecordedPose:
    p = _read_reference_point(row, mechanism.position(q))
    p1 = p + tool.offset * p / np.linalg.norm(p)
    points = None
    if image_path is None:
        points = np.array([row.numbers_or_none(POINT_COLUMNS[i : i + 2]) for i in (0, 2)])
    time = float(row.numbers(("time_s",))[0]) if "time_s" in row.cells else None
    return RecordedPose(row.cells["frame"], image_path, points, q, p1, time)


def _read_reference_point(row: TableRow, p: Floats) -> Floats:
    """Return the recorded reference point (3,) in mm, or else `p`, which the joints give.

    Raise `BadInput` if both are known and disagree.
    """
    if POSITION_COLUMNS[0] not in row.cells:
        return p
    recorded_p = row.numbers(POSITION_COLUMNS) * 1e3
    mismatch_mm = float(np.linalg.norm(recorded_p - p))
    if not mismatch_mm <= MAX_POSITION_MISMATCH_MM:
        is_in_mm = np.linalg.norm(recorded_p * 1e-3 - p) <= MAX_POSITION_MISMATCH_MM
        hint = " (this looks like mm)" if is_in_mm else ""
        expected = f"within {MAX_POSITION_MISMATCH_MM:g} mm of the position by the joints{hint}"
        raise BadInput(f"{row.location}: x_m, y_m, z_m", f"{mismatch_mm:.1f} mm from it", expected)
    return recorded_p


class RecordingWriter:
    """Writer of recordings that `load_recording` reads. A row is written only after its frame.

    Parameters
    ----------
    folder : Path
        New folder.
    mechanism : Kinematics
        Mechanism of the arm.
    """

    def __init__(self, folder: Path, mechanism: Kinematics) -> None:
        self._folder, self._mechanism, self._count = folder, mechanism, 0
        (folder / "frames").mkdir(parents=True)
        columns = ("frame", *JOINT_COLUMNS[mechanism.name], *POSITION_COLUMNS, "time_s")
        (folder / "poses.csv").write_text(",".join(columns) + "\n")

    def write(self, jpeg: bytes, q: Floats, exposure: int) -> None:
        """Add a frame.

        Parameters
        ----------
        jpeg : bytes
            Image as a JPEG file.
        q : Floats
            Joints (3,) at the exposure, in rad, rad, mm.
        exposure : int
            Time of the exposure in ns.
        """
        name = f"{self._count:05d}"
        (self._folder / "frames" / f"{name}.jpg").write_bytes(jpeg)
        values = np.concatenate([q * TO_RECORDED_UNITS, self._mechanism.position(q) * 1e-3])
        row = [name, *(f"{number:.9g}" for number in values), f"{exposure * 1e-9:.9f}"]
        with (self._folder / "poses.csv").open("a") as file:
            file.write(",".join(row) + "\n")
        self._count += 1
