"""Recordings are read in any common format, or refused in one sentence with the reason."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

import rcmservo as rs
from rcmservo.errors import RcmServoError
from rcmservo.recording.foreign.frame_folder import POINT_COLUMNS, RecordedPose, load_recording

MECHANISM, TOOL = rs.SphericalRcm(), rs.RigidTool(spacing=30.0)
TITLES = ("frame", "theta_rad", "phi_rad", "rho_m", "x_m", "y_m", "z_m", "time_s")
COUNT = 12


@dataclass
class Recording:
    """Recording of points as cells by title, with the format of its file."""

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

    def remove(self, *titles: str) -> None:
        for title in titles:
            del self.table[title]

    def write_images(self, name: str) -> None:
        self.remove(*POINT_COLUMNS)
        (self.folder / "frames").mkdir()
        for frame in self.table["frame"]:
            _, data = cv2.imencode(Path(name).suffix, np.full((12, 16, 3), 90, dtype=np.uint8))
            (self.folder / "frames" / name.format(frame)).write_bytes(data.tobytes())

    def load(self) -> list[RecordedPose]:
        rows = [list(self.table), *map(list, zip(*self.table.values(), strict=True))]
        rows[1:] = [[cell.replace(".", self.decimal) for cell in row] for row in rows[1:]]
        text = "".join(self.separator.join(row) + self.end for row in rows)
        (self.folder / "poses.csv").write_bytes(text.encode(self.encoding))
        return load_recording(self.folder, MECHANISM, TOOL)

    def error_sentence(self) -> str:
        with pytest.raises(RcmServoError) as caught:
            self.load()
        sentence = str(caught.value)
        assert "\n" not in sentence
        return sentence


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    return Recording(tmp_path)


def are_equal(poses: list[RecordedPose], others: list[RecordedPose]) -> bool:
    def numbers(pose: RecordedPose) -> list[float]:
        assert pose.points is not None and pose.time is not None
        return [*pose.q, *pose.p1, *pose.points.ravel(), pose.time]

    return [(pose.name, numbers(pose)) for pose in poses] == [
        (pose.name, numbers(pose)) for pose in others
    ]


# ---------------------------------------------------------------- accepted formats


def test_points_alone_are_a_recording(recording: Recording) -> None:
    poses = recording.load()
    assert len(poses) == COUNT
    assert poses[1].image_path is None and poses[1].points is not None
    np.testing.assert_allclose(poses[1].points, [[322.0, 311.0], [355.0, 333.0]])
    np.testing.assert_allclose(poses[1].q, [0.62, -0.45, 101.0])
    assert poses[1].time == 0.1


def test_both_cells_of_an_undetected_marker_are_empty(recording: Recording) -> None:
    recording.table["m1_u_px"][3] = recording.table["m1_v_px"][3] = ""
    points = recording.load()[3].points
    assert points is not None
    np.testing.assert_array_equal(np.isfinite(points).all(axis=1), [False, True])
    recording.table["m2_v_px"][5] = ""
    assert "frame 05: m2_v_px must be a finite number" in recording.error_sentence()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n", " \n\n"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (", ", "."), (";", "."), (";", ","), ("\t", ",")]
)
def test_the_format_of_a_table_does_not_change_its_content(
    encoding: str, end: str, separator: str, decimal: str, recording: Recording
) -> None:
    expected = recording.load()
    recording.encoding, recording.end = encoding, end
    recording.separator, recording.decimal = separator, decimal
    assert are_equal(recording.load(), expected)


@pytest.mark.parametrize("name", ["{}.jpg", "{}.JPG", "{}.jpeg", "{}.png", "{}.PNG"])
def test_images_are_found_with_any_common_suffix(name: str, recording: Recording) -> None:
    recording.write_images(name)
    (recording.folder / "frames" / f".{name}").write_bytes(b"left by another system")
    poses = recording.load()
    assert [pose.image_path and pose.image_path.name for pose in poses] == [
        name.format(f"{i:02d}") for i in range(COUNT)
    ]


# ---------------------------------------------------------------- refused


def test_joints_in_another_unit_are_refused_with_the_likely_unit(recording: Recording) -> None:
    recording.remove("x_m", "y_m", "z_m")
    recording.change("theta_rad", np.degrees)
    sentence = recording.error_sentence()
    assert "frame 00: theta_rad must be within the rig's limits" in sentence
    assert "(this looks like degrees)" in sentence and "got 34.3" in sentence
    recording.change("theta_rad", np.radians)
    recording.change("rho_m", lambda rho: 1e3 * rho)
    assert "rho_m must be" in (sentence := recording.error_sentence())
    assert "0.04 to 0.22 m (this looks like mm), got 100.0" in sentence


def test_joints_slightly_outside_the_limits_get_no_unit_hint(recording: Recording) -> None:
    recording.remove("x_m", "y_m", "z_m")
    recording.table["theta_rad"][7] = "1.6"
    sentence = recording.error_sentence()
    assert "frame 07: theta_rad" in sentence and "1.484 rad, got 1.6" in sentence
    recording.table["theta_rad"][7] = "1.49"
    assert len(recording.load()) == COUNT


def test_positions_in_mm_are_refused_with_their_likely_unit(recording: Recording) -> None:
    for title in ("x_m", "y_m", "z_m"):
        recording.change(title, lambda x: 1e3 * x)
    assert "the position by the joints (this looks like mm)" in recording.error_sentence()
    recording.change("x_m", lambda x: x + 5.0)
    assert "this looks like" not in recording.error_sentence()


@pytest.mark.parametrize(
    ("title", "purpose"),
    [
        ("frame", "frame, which a spherical mechanism"),
        ("rho_m", "rho_m, which a spherical mechanism"),
        ("m2_v_px", "m2_v_px, which a recording of points"),
        ("z_m", "z_m, which a position"),
    ],
)
def test_a_missing_column_is_named(title: str, purpose: str, recording: Recording) -> None:
    recording.remove(title)
    assert f"has no column {purpose} needs" in recording.error_sentence()


def test_decimal_commas_between_commas_are_reported(recording: Recording) -> None:
    recording.decimal = ","
    assert "frame 00: has more cells than there are titles; decimal" in recording.error_sentence()


def test_duplicate_columns_and_other_encodings_are_reported(recording: Recording) -> None:
    recording.table["rho_m "] = recording.table["rho_m"]
    assert "has two columns rho_m" in recording.error_sentence()
    recording.encoding = "utf-16"
    assert "is not a table of text in UTF-8" in recording.error_sentence()


def test_missing_images_and_points_are_both_reported(recording: Recording) -> None:
    recording.remove(*POINT_COLUMNS)
    assert "holds no images" in (sentence := recording.error_sentence())
    assert "m1_u_px, m1_v_px, m2_u_px, m2_v_px" in sentence
