"""A recording is read as others write it, or refused in one sentence that says what is wrong."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

import rcmservo as rs
from rcmservo.errors import RcmServoError
from rcmservo.offline.frames_folder import POINT_COLUMNS, Pose, load

MECHANISM, TOOL = rs.SphericalRcm(), rs.RigidTool(spacing=30.0)
TITLES = ("frame", "theta_rad", "phi_rad", "rho_m", "x_m", "y_m", "z_m", "time_s")
COUNT = 12


@dataclass
class Recording:
    """A recording of points on its way to a file: cells by title, and how they are written."""

    folder: Path
    table: dict[str, list[str]] = field(default_factory=dict)
    separator: str = ","
    encoding: str = "utf-8"
    end: str = "\n"
    decimal: str = "."

    def __post_init__(self) -> None:
        for i in range(COUNT):
            q = np.array([0.6 + 0.02 * i, -0.5 + 0.05 * i, 100.0 + i])
            p = MECHANISM.position(q) * 1e-3
            points = 300.0 + np.array([2.0, 1.0, 5.0, 3.0]) * (10 + i)
            cells = (f"{i:02d}", *(f"{x:.6f}" for x in (*q[:2], q[2] * 1e-3, *p, 0.1 * i, *points)))
            for title, cell in zip((*TITLES, *POINT_COLUMNS), cells, strict=True):
                self.table.setdefault(title, []).append(cell)

    def change(self, title: str, change: Callable[[float], float]) -> None:
        self.table[title] = [str(float(change(float(cell)))) for cell in self.table[title]]

    def without(self, *titles: str) -> None:
        for title in titles:
            del self.table[title]

    def with_pictures(self, name: str) -> None:
        self.without(*POINT_COLUMNS)
        (self.folder / "frames").mkdir()
        for frame in self.table["frame"]:
            _, data = cv2.imencode(Path(name).suffix, np.full((12, 16, 3), 90, dtype=np.uint8))
            (self.folder / "frames" / name.format(frame)).write_bytes(data.tobytes())

    def load(self) -> list[Pose]:
        rows = [list(self.table), *map(list, zip(*self.table.values(), strict=True))]
        rows[1:] = [[cell.replace(".", self.decimal) for cell in row] for row in rows[1:]]
        text = "".join(self.separator.join(row) + self.end for row in rows)
        (self.folder / "poses.csv").write_bytes(text.encode(self.encoding))
        return load(self.folder, MECHANISM, TOOL)

    def refused(self) -> str:
        with pytest.raises(RcmServoError) as caught:
            self.load()
        sentence = str(caught.value)
        assert "\n" not in sentence
        return sentence


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    return Recording(tmp_path)


def same(poses: list[Pose], others: list[Pose]) -> bool:
    def numbers(pose: Pose) -> list[float]:
        assert pose.points is not None and pose.time is not None
        return [*pose.q, *pose.p1, *pose.points.ravel(), pose.time]

    return [(pose.name, numbers(pose)) for pose in poses] == [
        (pose.name, numbers(pose)) for pose in others
    ]


# ---------------------------------------------------------------- as others write it


def test_points_alone_are_a_recording(recording: Recording) -> None:
    poses = recording.load()
    assert len(poses) == COUNT
    assert poses[1].picture is None and poses[1].points is not None
    np.testing.assert_allclose(poses[1].points, [[322.0, 311.0], [355.0, 333.0]])
    np.testing.assert_allclose(poses[1].q, [0.62, -0.45, 101.0])
    assert poses[1].time == 0.1


def test_of_a_marker_that_was_not_seen_both_cells_are_empty(recording: Recording) -> None:
    recording.table["m1_u_px"][3] = recording.table["m1_v_px"][3] = ""
    points = recording.load()[3].points
    assert points is not None
    np.testing.assert_array_equal(np.isfinite(points).all(axis=1), [False, True])
    recording.table["m2_v_px"][5] = ""
    assert "frame 05: m2_v_px must be a finite number" in recording.refused()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n", " \n\n"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (", ", "."), (";", "."), (";", ","), ("\t", ",")]
)
def test_a_table_is_the_same_however_it_is_written(
    encoding: str, end: str, separator: str, decimal: str, recording: Recording
) -> None:
    usual = recording.load()
    recording.encoding, recording.end = encoding, end
    recording.separator, recording.decimal = separator, decimal
    assert same(recording.load(), usual)


@pytest.mark.parametrize("name", ["{}.jpg", "{}.JPG", "{}.jpeg", "{}.png", "{}.PNG"])
def test_pictures_are_found_by_any_usual_ending(name: str, recording: Recording) -> None:
    recording.with_pictures(name)
    (recording.folder / "frames" / f".{name}").write_bytes(b"left by another system")
    poses = recording.load()
    assert [pose.picture and pose.picture.name for pose in poses] == [
        name.format(f"{i:02d}") for i in range(COUNT)
    ]


# ---------------------------------------------------------------- refused


def test_joints_in_another_unit_are_refused_with_the_likely_one(recording: Recording) -> None:
    recording.without("x_m", "y_m", "z_m")
    recording.change("theta_rad", np.degrees)
    sentence = recording.refused()
    assert "frame 00: theta_rad must be within the rig's limits" in sentence
    assert "(this looks like degrees)" in sentence and "got 34.3" in sentence
    recording.change("theta_rad", np.radians)
    recording.change("rho_m", lambda rho: 1e3 * rho)
    assert "rho_m must be" in (sentence := recording.refused())
    assert "0.04 to 0.22 m (this looks like mm), got 100.0" in sentence


def test_joints_a_little_beyond_the_limits_are_in_no_other_unit(recording: Recording) -> None:
    recording.without("x_m", "y_m", "z_m")
    recording.table["theta_rad"][7] = "1.6"
    sentence = recording.refused()
    assert "frame 07: theta_rad" in sentence and "1.484 rad, got 1.6" in sentence
    recording.table["theta_rad"][7] = "1.49"
    assert len(recording.load()) == COUNT


def test_positions_in_mm_are_refused_with_their_likely_unit(recording: Recording) -> None:
    for title in ("x_m", "y_m", "z_m"):
        recording.change(title, lambda x: 1e3 * x)
    assert "what the joints give (this looks like mm)" in recording.refused()
    recording.change("x_m", lambda x: x + 5.0)
    assert "this looks like" not in recording.refused()


@pytest.mark.parametrize(
    ("title", "needs"),
    [
        ("frame", "frame, which a spherical mechanism"),
        ("rho_m", "rho_m, which a spherical mechanism"),
        ("m2_v_px", "m2_v_px, which a recording of points"),
        ("z_m", "z_m, which a position"),
    ],
)
def test_a_column_that_is_missing_is_named(title: str, needs: str, recording: Recording) -> None:
    recording.without(title)
    assert f"has no column {needs} needs" in recording.refused()


def test_decimal_commas_between_commas_are_told(recording: Recording) -> None:
    recording.decimal = ","
    assert "frame 00: has more cells than there are titles; decimal" in recording.refused()


def test_two_columns_of_one_title_and_other_encodings_are_told(recording: Recording) -> None:
    recording.table["rho_m "] = recording.table["rho_m"]
    assert "has two columns rho_m" in recording.refused()
    recording.encoding = "utf-16"
    assert "is not a table of text in UTF-8" in recording.refused()


def test_without_pictures_and_points_both_are_told(recording: Recording) -> None:
    recording.without(*POINT_COLUMNS)
    assert "holds no frames" in (sentence := recording.refused())
    assert "m1_u_px, m1_v_px, m2_u_px, m2_v_px" in sentence
