"""`rs.load_rig`: the simulation or the devices of a rig file as a rig."""

from pathlib import Path

import pytest

import rcmservo as rs
from rcmservo.config.verified_rigs import compute_digest, mark_rig_verified
from rcmservo.live.device_protocols import NotReady

SIMULATED = """
[mechanism]
kind = "pitch-yaw"
[tool]
spacing = 40.0
[gate]
slew = [2.0, 2.0, 200.0]
[camera]
width = 320
height = 240
"""

WITH_ARM = """
[arm]
kind = "galil"
address = "127.0.0.1"
counts = [50000.0, 50000.0, 20.0]
[camera]
kind = "opencv"
source = "0"
latency = 0.02
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "lab.toml"
    path.write_text(text)
    return path


def test_a_file_without_an_arm_is_a_simulation_with_the_robot_of_the_file(tmp_path: Path) -> None:
    rig = rs.load_rig(write(tmp_path, SIMULATED), seed=3)
    assert rig.is_simulated and rig.describe()["seed"] == 3
    servo = rig.adapt(rs.Servo())
    assert servo.mechanism == rs.PitchYawRcm() and servo.tool == rs.RigidTool(40.0)
    assert servo.gate.slew == (2.0, 2.0, 200.0)
    frame = rig.plant.camera.latest()
    assert frame is not None and frame.image is not None and frame.image.shape == (240, 320, 3)


def test_an_arm_moves_at_a_tenth_of_its_speed_until_its_file_is_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    path = write(tmp_path, WITH_ARM)
    rig = rs.load_rig(path)
    assert not rig.is_simulated and "not connected, at 10 % of the full speed" in str(rig)
    full = rs.Servo().gate.speed
    assert rig.adapt(rs.Servo()).gate.speed == pytest.approx([0.1 * speed for speed in full])
    mark_rig_verified(compute_digest(path.read_bytes()))
    assert rig.adapt(rs.Servo()).gate.speed == full
    assert rig.describe()["rig_checked"] and rig.describe()["devices"]["arm"]["kind"] == "galil"


def test_nothing_is_connected_before_the_context(tmp_path: Path) -> None:
    rig = rs.load_rig(write(tmp_path, WITH_ARM))
    with pytest.raises(NotReady, match="write `with rig:`"):
        rig.teach()
    with pytest.raises(NotReady, match="write `with rig:`"):
        rig.arm.measure()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[arm]\nkind = 'robot'\n", "arm.kind must be one of galil, crtk"),
        (WITH_ARM.replace("latency = 0.02\n", ""), "camera.latency"),
        ("[tool]\nspacing = -1.0\n", "tool.spacing must be"),
        ("[tracker]\nkind = 'nothing_of_mine:Tracker'\n", "tracker.kind"),
    ],
)
def test_an_invalid_file_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(rs.BadInput) as refused:
        rs.load_rig(write(tmp_path, text))
    assert words in str(refused.value) and "\n" not in str(refused.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(rs.UnusableFile, match=r"nothing\.toml"):
        rs.load_rig(tmp_path / "nothing.toml")
