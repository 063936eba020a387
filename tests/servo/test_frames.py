"""Frames whose content, numbers or times are unusual, in whole runs of the default servo."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from changed_frames import (
    ChangedCamera,
    ChangeFrame,
    freeze_with_noise,
    misplace_marker,
    release_joint,
)

import rcmservo as rs
from conftest import ESTIMATORS, Laboratory, make_laboratory, make_random
from rcmservo.interfaces import ArmMeasurement, Command, Floats, Frame
from rcmservo.loop.plant import Plant
from rcmservo.tracking import PointMarkers


def change_camera(lab: Laboratory, change: ChangeFrame) -> Plant:
    camera = ChangedCamera(lab.rig.camera, change)
    return Plant(lab.rig.arm, camera, PointMarkers(), lab.rig.clock)


def repeat_content(is_repeated: Callable[[int], bool]) -> ChangeFrame:
    """Return a change that shows the last picture again in some frames, by their numbers."""

    def change(frame: Frame, delivered: Frame | None) -> Frame:
        if delivered is None or not is_repeated(frame.number):
            return frame
        return replace(frame, points=delivered.points)

    return change


def run(plant: Plant, lab: Laboratory, seconds: float = 5.0, **parts: object) -> list[rs.Tick]:
    return list(rs.servo_ticks(plant, lab.servo(**parts), lab.target, seconds))


def measure_error_mm(ticks: list[rs.Tick], lab: Laboratory) -> float:
    """Return the distance of marker 1 from its position during teaching at the end of a run."""
    positions = [
        lab.servo().position_of_marker_1(q) for q in (ticks[-1].observation.q, lab.target.q)
    ]
    return float(np.linalg.norm(positions[0] - positions[1]))


def list_stops(ticks: list[rs.Tick]) -> list[str]:
    """Return the causes for which the servo stopped the tool for more than a moment."""
    stopped = rs.Phase.PAUSED, rs.Phase.FAULT
    return sorted({tick.state.cause.name for tick in ticks if tick.state.phase in stopped})


@pytest.mark.parametrize("estimator", ["dlt", "fast", "correntropy"])
@pytest.mark.parametrize("period", [2, 7, 61])
def test_repeated_frames_do_not_stop_a_run(period: int, estimator: str) -> None:
    for seed in (11, 12):
        lab = make_laboratory(seed)
        plant = change_camera(lab, repeat_content(lambda number: number % period == 0))
        ticks = run(plant, lab, estimator=ESTIMATORS[estimator])
        assert list_stops(ticks) == []
        assert measure_error_mm(ticks, lab) < 2.0


@pytest.mark.parametrize("start", [40, 90, 110])
def test_a_frozen_image_still_stops_the_tool(start: int) -> None:
    lab = make_laboratory(11)
    first = round(60 * lab.rig.clock.now() * 1e-9)
    plant = change_camera(lab, repeat_content(lambda number: number > first + start))
    ticks = run(plant, lab)
    assert list_stops(ticks) == ["FROZEN"]
    begun = next(k for k, tick in enumerate(ticks) if tick.observation.frame > first + start)
    path_mm = np.diff(
        [lab.servo().position_of_marker_1(t.observation.q) for t in ticks[begun:]], axis=0
    )
    assert np.linalg.norm(path_mm, axis=1).sum() < 6.0


def test_a_tool_at_the_target_stays_there_while_a_noisy_image_freezes() -> None:
    """The image still answers to noise, and shows the same error wherever the tool is."""
    errors_mm = []
    for seed in range(13040, 13048):
        lab = make_laboratory(seed, rs.sim.RigSettings(point_noise=0.3))
        start = lab.rig.clock.now() + 4_000_000_000
        change = freeze_with_noise(0.1)(make_random(seed), lab.rig, start)
        ticks = run(change_camera(lab, change), lab, 20.0)
        is_stopped = ticks[-1].state.phase is not rs.Phase.SERVO
        errors_mm.append(0.0 if is_stopped else measure_error_mm(ticks, lab))
    assert np.count_nonzero(errors_mm) >= 6
    assert max(errors_mm) < 1.2


def test_a_tracker_of_whole_pixels_is_not_taken_for_a_frozen_camera() -> None:
    def round_points(frame: Frame, _: Frame | None) -> Frame:
        assert frame.points is not None
        return replace(frame, points=np.round(frame.points))

    for seed in (11, 12):
        lab = make_laboratory(seed)
        ticks = run(change_camera(lab, round_points), lab)
        assert list_stops(ticks) == []
        assert {tick.state.phase for tick in ticks[-100:]} == {rs.Phase.SERVO}


class ShiftedClock:
    """Clock that counts from another origin; the arm and the camera use it too."""

    def __init__(self, lab: Laboratory, shift: int) -> None:
        self._clock, self._arm, self._shift = lab.rig.clock, lab.rig.arm, shift

    def now(self) -> int:
        return self._clock.now() + self._shift

    def wait_until(self, time: int) -> None:
        self._clock.wait_until(time - self._shift)

    def enable(self) -> None:
        self._arm.enable()

    def measure(self) -> ArmMeasurement:
        measurement = self._arm.measure()
        return measurement._replace(time=measurement.time + self._shift)

    def apply(self, command: Command) -> Floats:
        time, deadline = command.time - self._shift, command.deadline - self._shift
        return self._arm.apply(replace(command, time=time, deadline=deadline))

    def change(self, frame: Frame, _: Frame | None) -> Frame:
        times = frame.exposure + self._shift, frame.arrival + self._shift
        return replace(frame, exposure=times[0], arrival=times[1])


@pytest.mark.parametrize("shift", [-(10**10), -3, 2**60])
def test_the_decisions_do_not_depend_on_the_origin_of_the_clock(shift: int) -> None:
    rates = []
    for origin in (0, shift):
        lab = make_laboratory(13)
        clock = ShiftedClock(lab, origin)
        camera = ChangedCamera(lab.rig.camera, clock.change)
        ticks = run(Plant(clock, camera, PointMarkers(), clock), lab, 3.0)
        rates.append(np.array([tick.state.command.rates for tick in ticks]))
    assert np.abs(rates[0]).max() > 0.1
    np.testing.assert_array_equal(rates[0], rates[1])


@pytest.mark.parametrize("bits", [16, 31, 32])
def test_a_frame_number_that_wraps_is_a_new_frame(bits: int) -> None:
    def wrap(frame: Frame, _: Frame | None) -> Frame:
        return replace(frame, number=(frame.number + (1 << bits) - 100) % (1 << bits))

    lab = make_laboratory(11)
    ticks = run(change_camera(lab, wrap), lab, 4.0)
    assert not any(tick.observation.drop_reason for tick in ticks)
    assert list_stops(ticks) == [] and measure_error_mm(ticks, lab) < 2.0


@pytest.mark.parametrize("index", [0, 1, 2, 3, 5, 8, 13, 21, 34, 55])
def test_a_single_wrong_frame_pauses_no_exploration(index: int) -> None:
    """The first frame included: later frames that agree with each other replace it."""
    for seed in (21, 22, 23):
        random, used = make_random(seed), list[int]()

        def change(frame: Frame, _: Frame | None, used=used, random=random) -> Frame:
            used.append(frame.number)
            return misplace_marker(frame, random) if len(used) - 1 == index else frame

        lab = make_laboratory(seed, rs.sim.RigSettings(point_noise=0.3))
        ticks = run(change_camera(lab, change), lab, 3.0)
        assert list_stops(ticks) == []
        assert ticks[-1].state.phase is rs.Phase.SERVO


def test_a_tenth_of_wrong_frames_pauses_few_runs() -> None:
    stops = []
    for seed in range(30, 42):
        random = make_random(seed)

        def change(frame: Frame, _: Frame | None, random=random) -> Frame:
            return misplace_marker(frame, random) if random.random() < 0.1 else frame

        lab = make_laboratory(seed, rs.sim.RigSettings(point_noise=0.3))
        stops += list_stops(run(change_camera(lab, change), lab, 6.0))
    assert len(stops) <= 1


def test_markers_swapped_in_a_tenth_of_the_frames_are_no_drift() -> None:
    """Such residuals have the same direction each time; their mean looked like a moved camera."""
    stops, errors_mm = [], []
    for seed in range(6000, 6006):
        random = make_random(seed)

        def change(frame: Frame, _: Frame | None, random=random) -> Frame:
            assert frame.points is not None
            swapped = frame.points[::-1].copy()
            return replace(frame, points=swapped) if random.random() < 0.1 else frame

        lab = make_laboratory(seed, rs.sim.RigSettings(point_noise=0.3))
        ticks = run(change_camera(lab, change), lab, 6.0)
        stops += list_stops(ticks)
        errors_mm += [measure_error_mm(ticks, lab)] if not list_stops(ticks) else []
    assert set(stops) <= {"SWAPPED"}
    assert len(errors_mm) >= 3 and max(errors_mm) < 1.0


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("after_s", [1.0, 1.8])
def test_a_joint_that_no_longer_moves_the_tool_is_among_the_reasons(
    joint: int, after_s: float
) -> None:
    texts = list[str]()
    for seed in (6000, 6002, 6004):
        lab = make_laboratory(seed)
        start = lab.rig.clock.now() + round(after_s * 1e9)
        change = release_joint(joint)(make_random(0), lab.rig, start)
        states = [tick.state for tick in run(change_camera(lab, change), lab, 6.0)]
        texts += [state.text for state in states if state.phase is rs.Phase.PAUSED][:1]
    assert texts
    for text in texts:
        assert "moves the tool" in text or "move the tool" in text or "joint positions" in text


def test_another_object_that_stays_stops_the_tool_after_three_frames() -> None:
    """It is no scattered false detection: the tool must not move blindly for longer."""
    lab = make_laboratory(21, rs.sim.RigSettings(point_noise=0.3))
    first = round(60 * lab.rig.clock.now() * 1e-9) + 110
    place = np.array([[200.0, 150.0]])

    def change(frame: Frame, _: Frame | None) -> Frame:
        assert frame.points is not None
        return replace(
            frame,
            points=np.concatenate([frame.points[:1], place])
            if frame.number > first
            else frame.points,
        )

    ticks = run(change_camera(lab, change), lab)
    stopped = next(tick for tick in ticks if tick.state.phase is rs.Phase.PAUSED)
    assert stopped.state.cause is rs.Cause.SURPRISED
    assert stopped.observation.frame == first + 3


@pytest.mark.parametrize("still", [[0], [1], [0, 1]])
def test_markers_that_stand_still_end_the_exploration_early_and_are_named(still: list[int]) -> None:
    for seed, noise in ((41, 0.1), (42, 0.3), (43, 0.3)):
        lab, random = make_laboratory(seed), make_random(seed)
        held = np.array([[330.0, 250.0], [270.0, 190.0]])

        def change(frame: Frame, _: Frame | None, held=held, random=random, noise=noise) -> Frame:
            assert frame.points is not None
            points = frame.points.copy()
            points[still] = held[still] + noise * random.standard_normal((len(still), 2))
            return replace(frame, points=points)

        ticks = run(change_camera(lab, change), lab)
        end = next(k for k, tick in enumerate(ticks) if tick.state.phase is rs.Phase.PAUSED)
        state = ticks[end].state
        assert state.cause is rs.Cause.STANDS_STILL
        assert [f"marker {k + 1} at" in state.detail for k in (0, 1)] == [
            k in still for k in (0, 1)
        ]
        servo = lab.servo()
        p1 = np.array([servo.position_of_marker_1(tick.observation.q) for tick in ticks[: end + 1]])
        assert np.linalg.norm(np.diff(p1, axis=0), axis=1).sum() < 30.0
        assert ticks[end].time - ticks[0].time < 2_000_000_000
