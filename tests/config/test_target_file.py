"""Target files: a target survives bit for bit and loads only for the setup it was taught with."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import rcmservo as rs
from rcmservo.cli.simulated_run.target import describe_simulated_setup
from rcmservo.config import target_file
from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.config.target_file import TargetSetup, compute_checksum
from rcmservo.tracking import MarkerAppearance

SETUP = TargetSetup(
    "one camera", 640, 480, rs.SphericalRcm(), rs.RigidTool(spacing=30.0), MarkerAppearance()
)
TARGET = rs.Target(
    np.array([[100.1, 50.25], [200.3, 1.0 / 3.0]]), np.array([0.7, 0.1, 120.0 / 7.0 + 100.0])
)
OTHER_SETUPS = {
    "tool.spacing 30.0, this rig has 50.0": replace(SETUP, tool=rs.RigidTool(spacing=50.0)),
    "tool.kind 'rigid', this rig has 'scaled'": replace(SETUP, tool=rs.ScaledTool(scale=1.3)),
    "mechanism.kind 'spherical', this rig has 'pitch-yaw'": replace(
        SETUP, mechanism=rs.PitchYawRcm()
    ),
    "mechanism.insertion_zero 0.0, this rig has 1.0": replace(
        SETUP, mechanism=rs.SphericalRcm(insertion_zero=1.0)
    ),
    "markers.radius_2 4.0, this rig has 5.0": replace(
        SETUP, markers=MarkerAppearance(radius_2=5.0)
    ),
    "camera 'one camera', this rig has 'another'": replace(SETUP, camera="another"),
    "width 640, this rig has 800": replace(SETUP, width=800),
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    target_file.save_target(tmp_path / "target.json", TARGET, SETUP)
    return tmp_path / "target.json"


def rewritten(path: Path, **changes: Any) -> Path:
    """Change values of the file and adapt its checksum."""
    content = json.loads(path.read_text()) | changes
    content = {
        key: value for key, value in content.items() if value != "left out" and key != "sha256"
    }
    path.write_text(json.dumps({**content, "sha256": compute_checksum(content)}))
    return path


pixels = st.tuples(st.floats(-0.5, 639.5), st.floats(-0.5, 479.5))


@given(
    st.tuples(pixels, pixels),
    st.tuples(st.floats(0.14, 1.48), st.floats(-3.14, 3.14), st.floats(40.0, 220.0)),
)
def test_every_number_survives_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, points: Any, q: Any
) -> None:
    assume(math.dist(*points) > 2.0)
    path = tmp_path_factory.mktemp("target") / "target.json"
    target_file.save_target(path, rs.Target(np.array(points), np.array(q)), SETUP)
    loaded = target_file.load_target(path, SETUP)
    assert loaded.points.tobytes() == np.array(points).tobytes()
    assert loaded.q.tobytes() == np.array(q).tobytes()


radii = st.one_of(st.just(np.nan), st.floats(1e-3, 640.0))


@given(st.tuples(radii, radii))
def test_known_and_unknown_sizes_survive_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, sizes: Any
) -> None:
    path, expected = tmp_path_factory.mktemp("target") / "target.json", np.array(sizes)
    target_file.save_target(path, replace(TARGET, sizes=expected), SETUP)
    assert target_file.load_target(path, SETUP).sizes.tobytes() == expected.tobytes()


def test_a_file_without_sizes_gives_nan(path: Path) -> None:
    assert np.isnan(
        target_file.load_target(rewritten(path, sizes_px="left out"), SETUP).sizes
    ).all()


@pytest.mark.parametrize("reason", OTHER_SETUPS)
def test_another_setup_is_refused_with_the_difference(reason: str, path: Path) -> None:
    with pytest.raises(rs.UnusableFile) as refused:
        target_file.load_target(path, OTHER_SETUPS[reason])
    assert str(refused.value) == f"{path}: was taught with {reason}: teach the target again"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"format": "rcmservo target 2"}, "not a target of this version"),
        ({"format": "left out"}, "not a target of this version"),
        ({"joints": "left out"}, "target.joints must be given"),
        ({"colour": 1}, "target.colour must be left out or one of taught, markers_px"),
        (
            {"taught": "yesterday"},
            "target.taught must be a time like 2026-11-21T11:30:00Z, got 'yesterday'",
        ),
        ({"taught": 3}, "target.taught must be text, got 3"),
        ({"setup": {}}, "was taught with camera None, this rig has 'one camera'"),
        ({"setup": 7}, "target.setup must be a table, got 7"),
        ({"joints": [0.7, 0.1]}, "target.joints[2] must be given, got [0.7, 0.1]"),
        ({"joints": [0.7, True, 120.0]}, "target.joints[1] must be a finite number, got True"),
        ({"joints": [0.7, 10**400, 120.0]}, "target.joints[1] must be a finite number"),
        (
            {"joints": [0.7, 0.1, 300.0]},
            "target.joints[2] must be rho within its limits 40 and 220, got 300.0",
        ),
        (
            {"markers_px": [[1.0, 2.0], [640.0, 2.0]]},
            "markers_px[1] must be within the image of 640 x 480 px, got (640.0, 2.0)",
        ),
        ({"sizes_px": [9.0, 0]}, "target.sizes_px[1] must be a positive radius within the image"),
        ({"sizes_px": [9.0]}, "target.sizes_px[1] must be given, got [9.0]"),
        ({"sizes_px": ["a", 9.0]}, "target.sizes_px[0] must be a finite number, got 'a'"),
        ({"markers_px": [[1.0, 2.0], "ab"]}, "target.markers_px[1] must be a list, got 'ab'"),
        (
            {"markers_px": [[1.0, 2.0], ["a", "b"]]},
            "target.markers_px[1][0] must be a finite number, got 'a'",
        ),
    ],
)
def test_an_invalid_value_is_reported(changes: dict[str, Any], reason: str, path: Path) -> None:
    with pytest.raises(rs.UnusableFile) as refused:
        target_file.load_target(rewritten(path, **changes), SETUP)
    assert reason in str(refused.value)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not valid JSON"),
        (b"7", "is not a target"),
        (b"\xff\xfe{}", "not valid JSON"),
        (b'{"a": 1, "a": 1}', "two of the key 'a'"),
        (b'{"a": NaN}', "NaN, which is not finite"),
        (b'{"a": 1e999}', "1e999, which is not finite"),
        (b"9" * 5000, "not valid JSON"),
        (b"[" * 60_000, "nested too deeply"),
        (b" " * 65_537, "larger than 65536 bytes"),
    ],
)
def test_a_file_without_a_target_is_refused(data: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "target.json"
    path.write_bytes(data)
    with pytest.raises(rs.UnusableFile) as refused:
        target_file.load_target(path, SETUP)
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_repeated_key_among_many_is_found_quickly(tmp_path: Path) -> None:
    path = tmp_path / "target.json"
    keys = [f'"{i}":1' for i in range(7000)]
    path.write_text("{" + ",".join([*keys, keys[-1]]) + "}")
    started = time.process_time()
    with pytest.raises(rs.UnusableFile, match="two of the key '6999'"):
        target_file.load_target(path, SETUP)
    assert time.process_time() - started < 0.2


def test_a_changed_digit_is_detected_by_the_checksum(path: Path) -> None:
    path.write_text(path.read_text().replace("50.25", "50.26"))
    with pytest.raises(rs.UnusableFile, match="checksum differs"):
        target_file.load_target(path, SETUP)


def test_a_target_outside_the_image_or_the_limits_is_not_written(tmp_path: Path) -> None:
    for target in (
        rs.Target(TARGET.points + 600.0, TARGET.q),
        rs.Target(TARGET.points * 0.0, TARGET.q),
        rs.Target(TARGET.points, TARGET.q + 200.0),
    ):
        with pytest.raises(rs.UnusableFile, match=r"is not written: target\."):
            target_file.save_target(tmp_path / "target.json", target, SETUP)
        assert not list(tmp_path.iterdir())


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(rs.UnusableFile, match=r"nothing\.json: cannot be read: No such file"):
        target_file.load_target(tmp_path / "nothing.json", SETUP)
    with pytest.raises(rs.UnusableFile, match="is not a file"):
        target_file.load_target(tmp_path, SETUP)


def test_a_simulated_camera_refuses_targets_of_other_cameras_and_positions(
    tmp_path: Path,
) -> None:
    path = tmp_path / "target.json"
    rig = rs.sim.Rig(3, pictures=False)
    target = rs.Target(np.array([[300.0, 200.0], [320.0, 260.0]]), rig.scene.target)
    target_file.save_target(path, target, describe_simulated_setup(rig, RigDescription()))
    again = target_file.load_target(
        path, describe_simulated_setup(rs.sim.Rig(3, pictures=False), RigDescription())
    )
    assert again.q.tobytes() == rig.scene.target.tobytes()
    with pytest.raises(
        rs.UnusableFile, match=r"was taught with camera 'simulation with seed 3, .* with seed 4, "
    ):
        target_file.load_target(
            path, describe_simulated_setup(rs.sim.Rig(4, pictures=False), RigDescription())
        )
    rig.relocate_camera()
    with pytest.raises(rs.UnusableFile, match="was taught with camera"):
        target_file.load_target(path, describe_simulated_setup(rig, RigDescription()))


def test_the_tolerance_beyond_joint_limits_is_the_threshold_of_the_rig(tmp_path: Path) -> None:
    lower, upper = SETUP.mechanism.limits.arrays
    q = (lower + upper) / 2.0
    q[2] = upper[2] + 0.008 * (upper[2] - lower[2])
    target, path = rs.Target(np.array([[100.0, 100.0], [120.0, 150.0]]), q), tmp_path / "t.json"
    rig = tmp_path / "rig.toml"
    rig.write_text("[thresholds]\nlimit_tolerance = 0.01\n")
    generous = replace(SETUP, slack=load_rig_file(rig).thresholds.limit_tolerance)
    with pytest.raises(rs.UnusableFile, match=r"target\.joints"):
        target_file.save_target(path, target, SETUP)
    target_file.save_target(path, target, generous)
    assert target_file.load_target(path, generous).q.tobytes() == q.tobytes()
    assert describe_simulated_setup(rs.sim.Rig(3, pictures=False), load_rig_file(rig)).slack == 0.01
