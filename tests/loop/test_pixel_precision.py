"""Precision of the image where the tool is: near the true one, or unknown."""

from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.interfaces import Floats
from rcmservo.loop.pixel_precision import compute_mm_per_px, describe_precision
from rcmservo.servo.state import State


class Watcher:
    """Operator who requests one thing at every tick and keeps the state at the end."""

    def __init__(self, request: Any, stops_after_exploration: bool) -> None:
        self.request, self.state = request, rs.Servo().init()
        self._stops = stops_after_exploration

    def __call__(self, tick: rs.Tick) -> Any:
        self.state = tick.state
        return rs.Request.PAUSE if self._stops and tick.state.explored else self.request


def observe(rig: rs.sim.Rig, watcher: Watcher, duration: float) -> State:
    rs.run(rig, rs.Servo(rig.mechanism, rig.tool), rig.teach(30), duration, operator=watcher)
    return watcher.state


def compute_true_mm_per_px(rig: rs.sim.Rig, q: Floats) -> float:
    """Return 1/σ₃ of ∂m/∂p₁ by central differences."""
    steps = np.diag([1e-5, 1e-5, 1e-3])
    pairs = [(q + step, q - step) for step in steps]
    pixels = [(rig.truth.pixels(a) - rig.truth.pixels(b)).ravel() for a, b in pairs]
    positions = [rig.mechanism.position(a) - rig.mechanism.position(b) for a, b in pairs]
    H = np.column_stack(pixels) @ np.linalg.inv(np.column_stack(positions))
    return float(1.0 / np.linalg.svd(H)[1][2])


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4])
def test_after_the_exploration_the_precision_is_near_the_true_one(seed: int) -> None:
    rig = rs.sim.Rig(seed, pictures=False)
    state = observe(rig, Watcher(rs.Request.NONE, True), 1.5)
    true = compute_true_mm_per_px(rig, rig.arm.measure().q)
    assert compute_mm_per_px(state, rig.tool) == pytest.approx(true, rel=0.35)


def test_the_motion_of_one_joint_does_not_show_the_precision() -> None:
    rig = rs.sim.Rig(0, pictures=False)
    state = observe(rig, Watcher(rs.Jog(np.array([0.1, 0.0, 0.0])), False), 1.0)
    assert np.isfinite(state.estimation.estimate.p1).all()
    assert np.isnan(compute_mm_per_px(state, rig.tool))
    assert describe_precision(state, rig.tool) == ""


def test_before_the_first_frame_the_precision_is_unknown() -> None:
    servo = rs.Servo()
    assert describe_precision(servo.init(), servo.tool) == ""


@pytest.mark.parametrize(("mm_per_px", "warns"), [(2.14, False), (9.9, False), (10.1, True)])
def test_a_place_where_a_tenth_of_a_px_is_a_mm_is_warned_of(
    mm_per_px: float, warns: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = "rcmservo.loop.pixel_precision.compute_mm_per_px"
    monkeypatch.setattr(place, lambda state, tool: mm_per_px)
    words = describe_precision(rs.Servo().init(), rs.Servo().tool)
    assert words.startswith(f"0.1 px is {0.1 * mm_per_px:.2g} mm here in the weakest direction")
    assert ("do not expect errors below 1 mm" in words) == warns
