"""`rig check` in a simulated laboratory: rates, latency and drive lag."""

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from rig_check_lab import MAX_TRAVEL_MM, FaultyLab, Mistake

from rcmservo.bringup.observations import MotionTrace
from rcmservo.bringup.timing import CameraLatency, compare_latency, identify_latency
from rcmservo.geometry.kinematics import PitchYawRcm
from rcmservo.interfaces import ArmMeasurement, Frame
from rcmservo.sim import RigSettings
from rcmservo.sim.cameras import Timing


def test_the_reported_rates_are_those_of_the_devices() -> None:
    quick = RigSettings(mechanism=PitchYawRcm(), timing=Timing(frame_rate=180.0))
    lab = FaultyLab(Mistake(), seed=1, settings=quick)
    measure, last = lab.arm.measure, [lab.arm.measure()]

    def each_4_ms() -> ArmMeasurement:
        if lab.rig.clock.now() - last[0].time >= 4_000_000:
            last[0] = measure()
        return last[0]

    lab.arm.measure = each_4_ms  # type: ignore[method-assign]
    lab.operator.override = lambda question: "no"
    report = lab.check()
    assert report.arm is not None and report.camera is not None
    assert abs(report.arm.rate - 250.0) < 1.0 and report.arm.jitter < 1e-4
    assert abs(report.camera.rate - 180.0) < 1.0 and report.camera.jitter < 1e-3
    assert not lab.arm.enabled


@pytest.mark.parametrize("error", [-0.25, -0.02, 0.0, 0.25])
def test_errors_of_exposure_times_are_identified_within_their_deviation(error: float) -> None:
    rng, trace = np.random.default_rng(0), MotionTrace()
    path = lambda t: np.array([0.0, 0.0, 1.5 * np.sin(2.0 * t)])  # noqa: E731
    trace.answers = [(k * 10_000_000, path(0.01 * k), np.zeros(3)) for k in range(1200)]
    for k in range(660):
        exposed = k / 60.0 + 0.5
        points = np.outer([4.0, -2.0, 3.0, 1.0], path(exposed)[2]).reshape(2, 2) + 100.0
        stamp = round((exposed - error) * 1e9)
        trace.frames.append((stamp, stamp + 30_000_000, points + rng.normal(0.0, 0.3, (2, 2))))
    latency = identify_latency(trace, joint=2)
    assert latency is not None
    assert abs(latency.latency - (0.03 - error)) < 4.0 * latency.deviation < 0.01


@pytest.mark.parametrize("backlash", [0.0, 0.2, 0.9])
def test_backlash_is_no_latency(backlash: float) -> None:
    """The joint moves up and down by 1.5 mm, and rests for a moment at each end."""
    rng, trace = np.random.default_rng(1), MotionTrace()
    times = 0.01 * np.arange(1200)
    motor = 1.5 * np.clip(1.5 * np.sin(2.0 * times), -1.0, 1.0)
    tool = np.array(list(accumulate(motor, lambda at, q: min(max(at, q), q + backlash))))
    joints = np.outer(motor, np.eye(3)[2])
    trace.answers = [(k * 10_000_000, q, np.zeros(3)) for k, q in enumerate(joints)]
    for exposed in np.arange(0.5, 11.5, 1.0 / 60.0):
        points = np.outer([4.0, -2.0, 3.0, 1.0], np.interp(exposed, times, tool)).reshape(2, 2)
        stamp = round(exposed * 1e9)
        trace.frames.append((stamp, stamp + 30_000_000, points + rng.normal(0.0, 0.3, (2, 2))))
    latency = identify_latency(trace, joint=2)
    assert latency is not None
    assert abs(latency.latency - 0.03) < 4.0 * latency.deviation < 0.01


def dated(by: float) -> Callable[[Frame], Frame]:
    """Return a change of frames that dates their exposure `by` s before the arrival."""
    return lambda frame: replace(frame, exposure=frame.arrival - round(by * 1e9))


@pytest.mark.slow
def test_the_identified_latency_and_lag_are_the_true_ones() -> None:
    lab = FaultyLab(Mistake(), seed=1, change=dated(0.0))
    lab.latency = None
    report = lab.check()
    assert report.latency is not None
    assert abs(report.latency.latency - 0.022) < 4.0 * report.latency.deviation < 0.01
    assert abs(report.lag - 0.024) < 0.01
    assert [finding.where for finding in report.findings] == ["camera.latency"]
    line = report.findings[0].line
    assert abs(float(line.removeprefix("latency = ")) - 0.022) < 0.005
    assert not report.ok


@pytest.mark.slow
def test_correct_timestamps_need_no_latency_and_an_arm_without_counts_only_its_signs() -> None:
    """Joint 3 is reversed."""
    lab = FaultyLab(Mistake(factors=(1.0, 1.0, -1.0)), seed=1, signs_only=True)
    lab.latency = 0.0
    report = lab.check()
    assert lab.arm.max_travel < MAX_TRAVEL_MM
    (found,) = report.findings
    assert report.done
    assert (found.where, found.line) == ("arm.signs[2]", "signs = [1.0, 1.0, 1.0]")


def test_a_missing_latency_is_reported_even_if_it_is_small() -> None:
    identified = CameraLatency(latency=0.001, reported=0.0, deviation=0.001, jitter=0.0)
    (finding,) = compare_latency(identified, None)
    assert finding.where == "camera.latency"
    assert finding.line == "latency = 0.001"


def test_timestamps_before_the_exposures_are_reported_without_a_line() -> None:
    identified = CameraLatency(latency=0.022, reported=0.042, deviation=0.001, jitter=0.0)
    (finding,) = compare_latency(identified, 0.0)
    assert finding.where == "camera.latency"
    assert not finding.line
    assert finding.expected.startswith("timestamps 0.020 s ± 0.001 s later")
