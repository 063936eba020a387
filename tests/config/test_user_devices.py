"""A user's own arm, camera or tracker in a rig file: what is accepted, refused and supplied."""

import json
import pickle
import re
import sys
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import rcmservo as rs
from conftest import SMALL_RIG_TOML
from rcmservo.cli.cli import load_options_class, main
from rcmservo.cli.lab.hardware_prompts import describe_target_setup
from rcmservo.cli.replay import replay
from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.config.target_file import load_target, save_target
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.hardware.device_kinds import (
    make_tracker,
    open_arm,
    open_camera,
    prepare_tracker,
    read_arm,
    read_latency,
    read_wiring,
)
from rcmservo.hardware.lab_rig import require_devices
from rcmservo.live.device_protocols import NotReady
from rcmservo.recording.foreign import scoring
from rcmservo.recording.writer import Recorder

MODULE = """
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import rcmservo as rs

if TYPE_CHECKING:
    from logging import Logger

MADE = []


class MyArm:
    "Own arm with the methods of the protocol only."

    def __init__(self, address: str, speeds: tuple[float, float, float] = (1.0, 1.0, 50.0)):
        self.address, self.speeds, self.enabled = address, speeds, False
        MADE.append(self)

    def enable(self):
        self.enabled = True

    def measure(self):
        return rs.ArmMeasurement(7, np.zeros(3), self.enabled)

    def apply(self, command):
        return np.zeros(3)


@dataclass
class StrictArm(MyArm):
    address: str
    timeout: float = 0.5
    log: "Logger | None" = None

    def __post_init__(self):
        MADE.append(self)
        if self.timeout < 0.0:
            raise rs.BadInput("timeout", self.timeout, "a time in s, not negative")


class RichArm(MyArm):
    "Own arm that reports why its drive went off and needs a mark for its joints."

    off_reason = "its watchdog"

    def is_homed(self):
        return False

    def set_position(self, q):
        self.q = q

    def close(self):
        self.address = "closed"


class HalfArm:
    def enable(self): ...


class UnreachableArm(MyArm):
    def __init__(self):
        raise OSError("no answer from 10.0.0.9")


class FreeArm(MyArm):
    def __init__(self, **settings):
        self.settings = settings


class MyCamera:
    def __init__(self):
        self.number = -1

    def latest(self):
        self.number += 1
        return rs.Frame(self.number // 2 * 5, 1, 2)


class LateCamera(MyCamera):
    def __init__(self, latency: float = 0.03):
        self.latency = latency


class MyTracker:
    "Own tracker that finds two markers where its settings are."

    def __init__(self, u: float, reason: str = ""):
        self.u, self.reason = u, reason

    def find(self, frame):
        u = np.nan if self.reason else self.u
        points = np.array([[u, 40.0], [u + 50.0, 60.0]])
        return rs.Markers(points, np.full(2, np.nan), np.ones(2))

    def reset(self): ...

    def explain_failure(self, frame):
        return self.reason


def my_arm():
    return MyArm("here")
"""

ARM = '[arm]\nkind = "own_lab:MyArm"\naddress = "10.0.0.9"\n'
CAMERA = '[camera]\nkind = "own_lab:MyCamera"\n'
TRACKER = '[tracker]\nkind = "own_lab:MyTracker"\nu = 70.0\n'


@pytest.fixture(autouse=True)
def import_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Restore the import path and forget the modules of the test; work in another folder."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    (elsewhere := tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(elsewhere)
    yield
    for name in ("own_lab", "broken_lab"):
        sys.modules.pop(name, None)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return a rig file of own devices, with their module next to it."""
    (tmp_path / "own_lab.py").write_text(MODULE)
    (tmp_path / "broken_lab.py").write_text("1 / 0\n")
    return write_rig(tmp_path / "lab.toml", ARM + CAMERA + TRACKER)


def write_rig(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def refusal_of(rig: Path, **options: Any) -> str:
    """Return the error of the rig file's devices; nothing has been constructed."""
    with pytest.raises(BadInput) as raised:
        require_devices(load_rig_file(rig), rig, "")
    assert not getattr(sys.modules.get("own_lab"), "MADE", [])
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_devices_with_the_methods_of_the_protocols_have_all_that_a_live_run_needs(
    rig: Path,
) -> None:
    lab = load_rig_file(rig)
    require_devices(lab, rig, "")
    assert sys.modules["own_lab"].MADE == []
    arm, camera = open_arm(lab), open_camera(lab)
    (made,) = sys.modules["own_lab"].MADE
    assert (made.address, made.speeds) == ("10.0.0.9", (1.0, 1.0, 50.0))
    assert arm.is_homed() and not arm.off_reason
    with pytest.raises(NotReady, match="MyArm has no method set_position"):
        arm.set_position(np.zeros(3))
    arm.enable()
    assert arm.measure().enabled
    arm.close()
    assert type(arm).__name__ == "MyArm" and type(camera).__name__ == "MyCamera"
    assert [camera.latest() is not None for _ in range(3)] and camera.counts().frames == 3
    camera.close()
    assert read_wiring(lab).has_signs_only and read_latency(lab) == (0.0, False)


def test_an_arm_with_more_methods_keeps_them(rig: Path) -> None:
    arm = open_arm(load_rig_file(write_rig(rig, ARM.replace("MyArm", "RichArm") + CAMERA)))
    assert not arm.is_homed() and arm.off_reason == "its watchdog"
    arm.set_position(np.ones(3))
    own: Any = arm
    assert (own.q == 1.0).all()
    arm.close()
    assert own.address == "closed"


def test_settings_are_decoded_to_the_types_of_the_constructor(rig: Path) -> None:
    write_rig(rig, f"{ARM}speeds = [1, 2, 3]\n")
    speeds = read_arm(load_rig_file(rig)).construct().speeds
    assert speeds == (1.0, 2.0, 3.0) and isinstance(speeds, tuple)
    write_rig(rig, ARM.replace("MyArm", "StrictArm") + "timeout = 2\n")
    assert read_arm(load_rig_file(rig)).construct().timeout == 2.0
    write_rig(rig, ARM.replace("MyArm", "FreeArm") + "taught = 2026-11-26\n")
    assert list(read_arm(load_rig_file(rig)).construct().settings) == ["address", "taught"]


def test_a_camera_that_takes_a_latency_has_the_key_in_the_rig_file(rig: Path) -> None:
    camera = CAMERA.replace("MyCamera", "LateCamera")
    assert read_latency(load_rig_file(write_rig(rig, ARM + camera))) == (0.03, True)
    write_rig(rig, f"{ARM}{camera}latency = 0.05\n")
    assert read_latency(load_rig_file(rig)) == (0.05, True)
    require_devices(load_rig_file(rig), rig, "")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (ARM.replace("MyArm", "NoArm") + CAMERA, "arm.kind must be a class; own_lab has no class"),
        (ARM.replace("MyArm", "my_arm") + CAMERA, "own_lab has no class my_arm, got"),
        (ARM.replace("own_lab", "no_lab") + CAMERA, "No module named 'no_lab'"),
        (ARM.replace("own_lab", "broken_lab") + CAMERA, "broken_lab raised ZeroDivisionError"),
        (ARM.replace("own_lab:", "own lab:") + CAMERA, "arm.kind must be module:class such as"),
        (ARM.replace("own_lab:MyArm", "gali") + CAMERA, "module:class such as my_lab:MyClass (did"),
        ('[arm]\nkind = "own_lab:HalfArm"\n' + CAMERA, "rcmservo.Arm; it lacks measure, apply"),
        (ARM + '[camera]\nkind = "own_lab:MyArm"\n', "rcmservo.Camera; it lacks latest, got"),
        (ARM + CAMERA + '[tracker]\nkind = "own_lab:MyArm"\n', "Tracker; it lacks find, reset"),
        (ARM + CAMERA + "[tracker]\nu = 1.0\n", "tracker.kind must be module:class"),
        (ARM + CAMERA + '[tracker]\nkind = "aruco"\n', "tracker.kind must be module:class"),
        ('[arm]\nkind = "own_lab:MyArm"\n' + CAMERA, "arm.address must be given"),
        (ARM.replace("address =", "adress =") + CAMERA, "(did you mean address?)"),
        (ARM.replace('"10.0.0.9"', "10") + CAMERA, "arm.address must be text, got 10"),
        (ARM + "speeds = [1.0, 2.0]\n" + CAMERA, "arm.speeds[2] must be given"),
        (ARM + CAMERA + "size = 3\n", "camera.size must be left out or one of kind, got 3"),
        (ARM + CAMERA + TRACKER.replace("70.0", "nan"), "tracker.u must be a finite number"),
    ],
)
def test_what_is_no_usable_device_is_refused_in_one_sentence_before_anything_is_made(
    rig: Path, text: str, sentence: str
) -> None:
    refusal = refusal_of(write_rig(rig, text))
    assert sentence in refusal and refusal.startswith(f"{rig}: ")


@pytest.mark.parametrize("command", ["live --rig", "serve --no-browser --rig", "rig check"])
def test_every_command_for_devices_refuses_an_arm_without_its_methods(
    rig: Path, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig(rig, '[arm]\nkind = "own_lab:HalfArm"\n' + CAMERA)
    assert main([*command.split(), str(rig)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"rcmservo: {rig}: arm.kind must be ") and error.count("\n") == 1
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            '[arm]\nkind = "own_lab:UnreachableArm"\n',
            "arm.kind must be a class whose constructor accepts its settings; it raised OSError: "
            "no answer from 10.0.0.9, got 'own_lab:UnreachableArm'",
        ),
        (
            ARM.replace("MyArm", "StrictArm") + "timeout = -1.0\n",
            "arm.timeout must be a time in s, not negative, got -1.0",
        ),
    ],
)
def test_an_error_of_a_constructor_names_file_section_and_class(
    rig: Path, text: str, sentence: str
) -> None:
    lab = load_rig_file(write_rig(rig, text + CAMERA))
    with pytest.raises(BadInput) as raised:
        open_arm(lab)
    assert str(raised.value) == f"{rig}: {sentence}"


def test_a_tracker_is_made_in_any_process(rig: Path) -> None:
    make = prepare_tracker(load_rig_file(rig))
    copied: Any = pickle.loads(pickle.dumps(make))()
    assert copied.u == 70.0
    without = load_rig_file(write_rig(rig, "[markers]\nradius_1 = 5.0\n"))
    assert make_tracker(without).look.radius_1 == 5.0  # type: ignore[attr-defined]


def test_a_target_is_valid_only_for_its_own_tracker_and_camera(rig: Path, tmp_path: Path) -> None:
    target, path = (
        rs.Target(np.array([[9.0, 9.0], [9.0, 19.0]]), np.array([0.6, 0.2, 120.0])),
        tmp_path / "t.json",
    )
    save_target(path, target, describe_target_setup(load_rig_file(rig), 64, 48))
    load_target(path, describe_target_setup(load_rig_file(rig), 64, 48))
    for text, reason in (
        (ARM + CAMERA + TRACKER.replace("70", "71"), "markers.u 70.0, this rig has 71.0"),
        (ARM + CAMERA, "markers.kind 'own_lab:MyTracker', this rig has None"),
        (ARM + TRACKER + CAMERA.replace("My", "Late"), 'this rig has \'{"kind": "own_lab:Late'),
    ):
        other = describe_target_setup(load_rig_file(write_rig(rig, text)), 64, 48)
        with pytest.raises(UnusableFile, match=re.escape(reason)):
            load_target(path, other)


def test_the_markers_command_shows_what_the_own_tracker_detects(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(frame := tmp_path / "frame.png"), np.full((240, 320, 3), 90, np.uint8))
    words = ["markers", str(frame), "--rig", str(rig)]
    assert main([*words, "--json", "--picture", str(tmp_path / "out.png")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["markers"] == [[70.0, 40.0], [120.0, 60.0]] and found["look"] is None
    assert (tmp_path / "out.png").is_file()
    assert main([*words, "--choose", "green,blue"]) == 2
    assert "has its own [tracker]" in capsys.readouterr().err
    write_rig(rig, f'{TRACKER}reason = "no light"\n')
    assert main(words) == 1
    assert (
        "the rig file's tracker does not detect both markers: no light" in capsys.readouterr().out
    )


def test_a_simulated_run_uses_the_own_tracker(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig(rig, f'{TRACKER}reason = "no light for my tracker"\n{SMALL_RIG_TOML}')
    words = ["run", "--rig", str(rig), "--no-video", "--teaching-frames", "5"]
    assert main([*words, "--out", "out"]) == 2
    assert "no light for my tracker" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["replay", "show", "export"])
def test_a_record_that_names_own_devices_imports_nothing(
    rig: Path, command: str, tmp_path: Path
) -> None:
    devices = {
        "arm": {"kind": "own_lab:MyArm", "serviced": date(2026, 11, 26)},
        "tracker": {"kind": "own_lab:MyTracker"},
    }
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
    with Recorder(tmp_path / "record.mcap", {"devices": devices, **devices}) as recorder:
        recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))
    out = [] if command == "replay" else ["--out", "out"]
    assert main([command, str(tmp_path / "record.mcap"), *out]) == 0
    assert "own_lab" not in sys.modules


def test_a_study_refuses_own_devices_and_imports_nothing(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "study.toml"
    tracker = TRACKER.replace("[tracker]", "[distribution.mine.tracker]")
    study.write_text(f'scenes = ["mine"]\n{tracker}')
    assert main(["study", str(study), "--out", "out"]) == 2
    assert "tracker" in capsys.readouterr().err and "own_lab" not in sys.modules


def test_a_recording_is_tracked_by_the_own_tracker(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trackers: list[Any] = []

    def stop_at_tracker(path: Path, lab: RigDescription, tracker: Any, *_: Any) -> None:
        trackers.append(tracker)
        raise UnusableFile(path, "enough")

    monkeypatch.setattr(scoring, "score_recording", stop_at_tracker)
    with pytest.raises(UnusableFile, match="enough"):
        replay(load_options_class("replay", [])(tmp_path, rig=rig))
    assert [tracker.u for tracker in trackers] == [70.0]
