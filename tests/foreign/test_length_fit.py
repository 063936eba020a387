"""Lengths of an arm and its tool by a recording: intervals that hold the truth, and how wide."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from conftest import SPACING_MM, make_random, mark_others_slow
from rcmservo.estimation.base import Sample
from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.geometry.tool import RigidTool, ScaledTool
from rcmservo.interfaces import Floats
from rcmservo.recording.foreign import length_fit
from rcmservo.recording.foreign.length_fit import LengthEstimate, fit_lengths
from rcmservo.sim import Imperfections, Rig, RigSettings

MECHANISM, TOOL = SphericalRcm(), RigidTool(spacing=SPACING_MM)
WIDE, NARROW = (0.3, 0.4, 30.0), (0.1, 0.1, 10.0)
"""Half of the range of each joint (rad, rad, mm)."""
FRAMES = 40
NOISE_PX = 0.3
JOINT_ERRORS = 0.002, 0.002, 0.1
"""Standard deviations (rad, rad, mm) of the joints, which move both markers alike."""
UNKNOWN = np.full(2, np.nan)


class Recording(NamedTuple):
    """Simulated recording, and the true corrections (6,) of its lengths in mm."""

    samples: list[Sample]
    truth: Floats


@cache
def record(seed: int, motion: tuple[float, float, float], errors: float = 1.0) -> Recording:
    """Return a recording of stills by an arm whose lengths differ from its rig file.

    `errors` is a factor on the noise and on the errors of the joints.
    """
    random = make_random(seed)
    imperfections = Imperfections(
        marker_distance=random.uniform(0.0, 3.0),
        spacing_error=random.uniform(-0.1, 0.1),
        insertion_error=random.uniform(-10.0, 10.0),
    )
    rig = Rig(seed, RigSettings(imperfections=imperfections), pictures=False)
    samples: list[Sample] = []
    while len(samples) < FRAMES:
        q = rig.scene.midpoint + random.uniform(-1.0, 1.0, 3) * motion
        points = rig.scene.optics.project(rig.body.points(q)[:2])
        points += errors * random.normal(0.0, NOISE_PX, points.shape)
        reported = q + errors * random.normal(0.0, JOINT_ERRORS)
        if np.all((points >= 0.0) & (points < [640.0, 480.0])):
            samples.append(Sample(MECHANISM.position(reported), points, UNKNOWN, 0.0, UNKNOWN))
    arm = rig.body.imperfections
    spacing = SPACING_MM * (arm.spacing_ratio - 1.0)
    truth = np.array([arm.insertion_error, spacing, *arm.marker_offsets.ravel()])
    return Recording(samples, truth)


def corrections(lengths: list[LengthEstimate]) -> Floats:
    return np.array([length.value - length.described for length in lengths])


def half_widths(lengths: list[LengthEstimate]) -> Floats:
    return np.array([length.half_width for length in lengths])


@cache
def compute_errors(seed: int, motion: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """Return the absolute errors and the half widths (6,) in mm of a recording's lengths."""
    samples, truth = record(seed, motion)
    lengths = fit_lengths(MECHANISM, TOOL, samples)
    return np.abs(corrections(lengths) - truth), half_widths(lengths)


@pytest.mark.parametrize("motion", mark_others_slow([WIDE, NARROW]))
def test_an_interval_holds_the_true_length_in_about_95_percent(
    motion: tuple[float, float, float],
) -> None:
    """Errors of the joints are alike in both markers; as independent noise they gave 90 %."""
    fits = [compute_errors(seed, motion) for seed in range(100)]
    is_held = np.array([error <= half_width for error, half_width in fits])
    assert 0.92 <= is_held.mean() <= 0.99
    assert is_held.mean(axis=0).min() >= 0.9


def test_a_wide_motion_determines_every_length() -> None:
    assert compute_determined_fractions(WIDE).min() >= 0.9


def test_a_narrow_motion_determines_the_spacing_only() -> None:
    zero, spacing, *offsets = compute_determined_fractions(NARROW)
    assert spacing >= 0.9 and max(zero, *offsets) <= 0.1


def compute_determined_fractions(motion: tuple[float, float, float]) -> Floats:
    """Return the fraction (6,) of 20 recordings that determine each length."""
    return np.mean([compute_errors(seed, motion)[1] <= 5.0 for seed in range(20)], axis=0)


def test_ten_times_smaller_errors_give_ten_times_narrower_intervals() -> None:
    """A prior whose weight does not follow the errors outweighs precise pixels."""
    ratios = [
        half_widths(fit_lengths(MECHANISM, TOOL, record(seed, NARROW, 0.1).samples))
        / half_widths(fit_lengths(MECHANISM, TOOL, record(seed, NARROW).samples))
        for seed in range(10)
    ]
    assert np.median(ratios, axis=0) == pytest.approx(np.full(6, 0.1), abs=0.04)


def test_the_lengths_do_not_depend_on_those_of_the_rig_file() -> None:
    """A prior that counts pulls the lengths to the rig file and narrows their intervals."""
    samples, _ = record(0, WIDE)
    lengths = fit_lengths(MECHANISM, TOOL, samples)
    mechanism, tool = SphericalRcm(insertion_zero=10.0), RigidTool(spacing=SPACING_MM - 10.0)
    moved = [one._replace(p1=one.p1 * (1.0 + 10.0 / np.linalg.norm(one.p1))) for one in samples]
    others = fit_lengths(mechanism, tool, moved)
    assert [one.value for one in others] == pytest.approx([one.value for one in lengths], abs=0.02)
    assert half_widths(others) == pytest.approx(half_widths(lengths), rel=0.02)


def test_a_tool_at_rest_adds_nothing_to_its_motion() -> None:
    """Errors that repeat in every frame at rest otherwise count as independent."""
    samples, _ = record(0, WIDE)
    lengths = fit_lengths(MECHANISM, TOOL, samples)
    assert fit_lengths(MECHANISM, TOOL, [*samples, *[samples[-1]] * 200]) == lengths


def test_a_long_recording_is_thinned_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    samples, _ = record(0, WIDE)
    every_second = fit_lengths(MECHANISM, TOOL, samples[::2])
    monkeypatch.setattr(length_fit, "MAX_FRAMES", FRAMES // 2)
    assert fit_lengths(MECHANISM, TOOL, samples) == every_second


@pytest.mark.parametrize("count", [1, 9])
def test_few_poses_determine_no_length(count: int) -> None:
    lengths = fit_lengths(MECHANISM, TOOL, record(0, WIDE).samples[:count])
    assert [one.name for one in lengths[:3]] == [
        "insertion_zero",
        "spacing",
        "marker_1_off_axis_along_theta",
    ]
    assert np.isinf(half_widths(lengths)).all()
    assert not any(one.is_determined for one in lengths)


def test_an_insertion_alone_leaves_the_offsets_open() -> None:
    """All markers are on one line then, and the pixels have fewer equations than unknowns."""
    samples, _ = record(0, WIDE)
    rig = Rig(0, pictures=False)
    on_line: list[Sample] = []
    for depth in np.linspace(-20.0, 20.0, 30):
        q = rig.scene.midpoint + np.array([0.0, 0.0, depth])
        points = rig.scene.optics.project(rig.body.points(q)[:2])
        on_line.append(samples[0]._replace(p1=MECHANISM.position(q), points=points))
    lengths = fit_lengths(MECHANISM, TOOL, on_line)
    assert np.isinf(half_widths(lengths)[2:]).all()


def test_a_scaled_tool_has_no_constant_spacing_to_report() -> None:
    assert fit_lengths(MECHANISM, ScaledTool(scale=1.3), record(0, WIDE).samples) == []
