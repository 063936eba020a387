"""Devices of a lab for the page: allowed speed, and rig files that are refused early."""

from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcmservo.cli.lab import page_rig
from rcmservo.cli.lab.serve import ServeOptions, serve
from rcmservo.config.verified_rigs import compute_digest, mark_rig_verified
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput
from rcmservo.hardware.lab_rig import LabRig
from rcmservo.interfaces import Frame
from rcmservo.live.frame_ring import FrameRing, RecordingCamera, RingCamera
from rcmservo.loop.run_result import CameraStatistics
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import SettingsChange

RIG = (
    '[arm]\nkind = "galil"\naddress = "127.0.0.1"\nport = 1\ncounts = [50000.0, 50000.0, 500.0]\n'
    '[camera]\nkind = "opencv"\nsource = "0"\nlatency = 0.02\n'
)


class StillCamera:
    """Camera with one image."""

    def __init__(self, *shape: int) -> None:
        self.frame = Frame(3, 1, 2, image=np.full((*shape, 3), 7, np.uint8))

    def latest(self) -> Frame:
        return self.frame

    def counts(self) -> CameraStatistics:
        return CameraStatistics()

    def close(self) -> None:
        """Do nothing, because nothing is open."""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(page_rig, "open_camera", lambda lab: StillCamera(24, 32))
    (path := tmp_path / "lab.toml").write_text(RIG)
    return path


@pytest.mark.parametrize("checked", [False, True])
def test_a_session_uses_the_speed_that_its_rig_file_allows(
    rig: Path, checked: bool, tmp_path: Path
) -> None:
    share = 1.0 if checked else 0.1
    if checked:
        mark_rig_verified(compute_digest(rig.read_bytes()))
    given = ServeOptions(rig=rig)
    lab_rig = LabRig(given.rig, given.lab, given.digest)
    with page_rig.open_hardware(given, lab_rig) as backend:
        assert (backend.setup.width, backend.setup.height) == (32, 24)
        assert ("10 %" in backend.title) is not checked
        fast = SaturatedController(max_speed=55.0)
        backend.servo_settings.apply(SettingsChange("controller", fast))
        if not checked:  # a check that passes later changes neither the speed nor the record
            mark_rig_verified(compute_digest(rig.read_bytes()))
        made = backend.session(PageChannels(get_context("spawn")), tmp_path / "session-1")
    assert np.allclose(made.servo.gate.speed, share * np.array(given.servo.gate.speed))
    assert made.servo.controller.max_speed == pytest.approx(share * 55.0)
    obtain_target: Any = made.target
    (at,) = obtain_target.args
    assert at.servo is made.servo
    words = "rig check` has passed" if checked else "10 % of the full speed"
    assert (
        words in at.motion_announcement
        and "Nothing moves until you hold a jog button" in at.motion_announcement
    )
    recorded: Any = made.recorder
    assert recorded.args[1]["speed_scale"] == share and recorded.args[1]["simulation"] is False
    assert made.consent is page_rig.require_drive_off


@pytest.mark.parametrize(
    ("more", "options", "why"),
    [("", {"seed": 3}, "--seed must be left out"), ("latency = 0.02\n", {}, "latency")],
)
def test_an_invalid_rig_file_is_reported_before_anything_is_connected(
    rig: Path, tmp_path: Path, more: str, options: dict[str, Any], why: str
) -> None:
    rig.write_text(RIG.replace(more, "") if more else RIG)
    with pytest.raises(BadInput, match=why):
        serve(ServeOptions(rig=rig, out=tmp_path / "out", **options))
    assert not (tmp_path / "out").exists()


def test_the_ring_receives_the_frames_except_those_of_another_size() -> None:
    ring = FrameRing(get_context("spawn"), 32, 24)
    reader, camera = RingCamera(ring), StillCamera(24, 32)
    recording = RecordingCamera(camera, ring)
    assert reader.latest() is None and recording.latest() is camera.frame
    frame = reader.latest()
    assert frame is not None and frame.image is not None and frame.number == 3
    assert (frame.image == 7).all()
    recording.latest()
    assert ring.entries.newest == 0
    camera.frame = StillCamera(12, 12).frame
    assert recording.latest() is camera.frame and ring.entries.newest == 0
