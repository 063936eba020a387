"""A user's own arm, camera and tracker in a rig file: `live` and `serve` in wall time."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from terminal_process import AtTerminal, live, wait_for
from test_page_rig import PageOperator, serving

from rcmservo.config.verified_rigs import compute_digest, mark_rig_verified
from rcmservo.recording.reader import read_record
from stalls import retry_after_stalls

pytestmark = pytest.mark.slow

SECONDS = "4"
"""Duration in s of a run that settles."""
START, GOAL = "0.6 0.2 120.0", "0.7 0.35 130.0"

MODULE = """
from pathlib import Path

import numpy as np
import own_devices  # hides the simulator
import rcmservo as rs

SHARED = bytearray(32)


class MyArm(own_devices.OwnArm):
    "Own arm that the test moves by hand: a file has the joints while the drive is off."

    def __init__(self, hand: str):
        super().__init__(SHARED)
        self.hand = Path(__file__).parent / hand

    def measure(self):
        if not self.enabled and (words := self.hand.read_text().split()):
            self.place([float(word) for word in words])
        return super().measure()

    def enable(self):
        super().enable()
        self.hand.write_text("")

    def apply(self, command):
        rates = super().apply(command)
        if np.any(rates):
            (self.hand.parent / "moved").touch()
        return rates

    def close(self):
        (self.hand.parent / "closed").touch()


class MyCamera(own_devices.OwnCamera):
    def __init__(self):
        super().__init__(SHARED)


class MyTracker:
    "Own tracker: the centroids of what is greener and bluer than grey."

    def __init__(self, contrast: float):
        self.contrast = contrast

    def find(self, frame):
        blue, green, red = np.moveaxis(frame.image.astype(float), 2, 0)
        colours = green - np.maximum(blue, red), blue - np.maximum(green, red)
        points = np.array([self.centroid(colour) for colour in colours])
        return rs.Markers(points, np.full(2, np.nan), np.ones(2))

    def centroid(self, colour):
        weight = np.clip(colour - self.contrast, 0.0, None)
        v, u = np.indices(weight.shape)
        total = weight.sum()
        return [(u * weight).sum() / total, (v * weight).sum() / total] if total else [np.nan] * 2

    def reset(self): ...
"""

RIG = """
[arm]
kind = "my_wall_lab:MyArm"
hand = "hand.txt"
[camera]
kind = "my_wall_lab:MyCamera"
[tracker]
kind = "my_wall_lab:MyTracker"
contrast = 20.0
[thresholds]
max_tick_delay = 1.0
max_latency = 1.0
max_frame_age_slow = 50.0
max_frame_age_hold = 50.0
arm_timeout = 1.0
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return a rig file of own devices, with their module next to it."""
    (tmp_path / "my_wall_lab.py").write_text(MODULE)
    (tmp_path / "hand.txt").write_text(START)
    (path := tmp_path / "lab.toml").write_text(RIG)
    return path


def test_live_servoes_own_devices_to_a_taught_target_without_the_simulator(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    mark_rig_verified(compute_digest(rig.read_bytes()))
    folders = (tmp_path / name for name in "abcdef")
    hand = tmp_path / "hand.txt"

    def attempt() -> tuple[Path, dict[str, Any]]:
        out = next(folders)
        hand.write_text(START)
        command = live(rig, "--out", str(out), "--duration", SECONDS)
        with AtTerminal(command, XDG_STATE_HOME=str(tmp_path)) as at:
            at.until("Move the tool to the target by hand")
            hand.write_text(GOAL)
            at.type("\n")
            at.until("Move the tool to its start by hand")
            hand.write_text(START)
            at.type("\n")
            at.until("any other answer ends the program: ")
            at.type("enable\n")
            code = at.end()
        metrics = json.loads((out / "metrics.json").read_text())
        assert code == (0 if metrics["settled"] else 1), at.shown
        return out, metrics

    out, metrics = retry_after_stalls(attempt, lambda run: run[1]["settled"])
    record = read_record(out)
    assert metrics["settled"] and metrics["simulated"] is False, metrics
    assert metrics["camera"]["frames"] > 30 and (tmp_path / "closed").exists()
    assert record.complete and "SERVO" in record.phase
    q = record.ticks["q"][-1]
    assert (np.abs(q - np.array(GOAL.split(), float)) < np.array([0.03, 0.03, 2.0])).all()


def test_own_devices_are_enabled_jogged_and_stopped_at_the_page(rig: Path, tmp_path: Path) -> None:
    lab: Any = SimpleNamespace(lab=lambda: rig)
    with serving(lab, tmp_path) as (_, address):
        at = PageOperator(address)
        wait_for(lambda: "enable" in at.now["can"])
        wait_for(lambda: None not in (at.now["points"] or [None]) and at.now["frame"] > 0)
        at.enable()
        at.jog(True)
        wait_for((tmp_path / "moved").exists)
        at.stop()
        at.until_words("STOP was pressed: the servo switched the arm's drive off")
        at.jogs = False
    record = read_record(tmp_path / "out/session-1")
    assert record.complete and np.abs(record.ticks["command"]).max() > 0.0
