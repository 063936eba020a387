"""Requirements on a rig file before `live --rig` connects to a device."""

from pathlib import Path

import pytest

from rcmservo.config.rig_file import decode_rig_file, read_rig_file
from rcmservo.config.verified_rigs import compute_digest, mark_rig_verified
from rcmservo.errors import BadInput
from rcmservo.hardware.lab_rig import require_devices

SPEED_ARM = """
[arm]
kind = "crtk"
namespace = "PSM1"
jv = true
[camera]
kind = "opencv"
source = "/dev/video0"
latency = 0.03
"""


def test_an_arm_receives_speeds_only_after_its_watchdog_is_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    rig = tmp_path / "lab.toml"
    rig.write_text(SPEED_ARM)
    data = read_rig_file(rig)
    lab, digest = decode_rig_file(rig, data), compute_digest(data)
    with pytest.raises(BadInput, match="`rig check` of this file has verified"):
        require_devices(lab, rig, digest)
    mark_rig_verified(digest)
    require_devices(lab, rig, digest)


def test_a_camera_without_a_measured_latency_is_refused(tmp_path: Path) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(SPEED_ARM.replace("jv = true\n", "").replace("latency = 0.03\n", ""))
    with pytest.raises(BadInput, match=r"camera\.latency"):
        require_devices(decode_rig_file(rig, read_rig_file(rig)), rig, "")
