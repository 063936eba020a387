"""`rs.testing` finds each planted fault in a part of a user, and none in parts that work."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import udp_arm
from toy_arm import ToyArm
from toy_wire import ASK, ToyOrder, sent

import rcmservo as rs
from conftest import ESTIMATORS, ROOT, make_environment
from rcmservo.control.feature_vectors import FEATURE_VECTORS

MS = 1_000_000
BOOT_NS = 5_000_000_000_000
"""Time in ns at which the clock of the tests begins."""
POINTS = np.array([[310.0, 140.0], [330.0, 201.0]])


class StepClock:
    """Clock in simulated time: it advances in `wait_until`, and by 1 ns at each reading."""

    def __init__(self) -> None:
        self.time = BOOT_NS

    def now(self) -> int:
        self.time += 1
        return self.time

    def wait_until(self, time: int) -> None:
        self.time = max(self.time, time)


class WorkingArm:
    """Arm whose joints follow their rates at once, with a watchdog."""

    def __init__(self, clock: StepClock) -> None:
        self.clock, self.q = clock, np.array([0.6, 0.2, 120.0])
        self.rates, self.on, self.deadline, self.time = np.zeros(3), False, 0, clock.now()

    def enable(self) -> None:
        self.advance()
        self.rates, self.on, self.deadline = np.zeros(3), True, self.clock.time + 50 * MS

    def advance(self) -> None:
        now = self.clock.now()
        self.q = self.q + self.rates * (min(now, max(self.deadline, self.time)) - self.time) * 1e-9
        self.time = now
        if now > self.deadline:
            self.rates, self.on = np.zeros(3), False

    def measure(self) -> Any:
        self.advance()
        return rs.ArmMeasurement(self.time, self.q.copy(), self.on)

    def apply(self, command: rs.Command) -> Any:
        self.advance()
        if not command.enabled:
            self.rates, self.on = np.zeros(3), False
        elif self.on and self.time <= command.deadline:
            self.rates, self.deadline = command.rates.copy(), command.deadline
        return self.rates.copy()


class WorkingCamera:
    """Camera with 100 frames a second and images of noise, 15 ms after their exposure."""

    def __init__(self, clock: StepClock) -> None:
        self.clock, self.frame = clock, None

    def latest(self) -> Any:
        number = (self.clock.now() - BOOT_NS - 15 * MS) // (10 * MS)
        if self.frame is None or number > self.frame.number:
            self.frame = self.expose(number)
        return self.frame

    def expose(self, number: int) -> Any:
        exposure = BOOT_NS + number * 10 * MS
        return rs.Frame(number, exposure, exposure + 15 * MS, image=self.image(number))

    def image(self, number: int) -> Any:
        return np.full((4, 6, 3), number % 251, np.uint8)


class WorkingTracker:
    """Tracker that reads the markers which a frame carries, and remembers none."""

    def reset(self) -> None:
        pass

    def find(self, frame: rs.Frame) -> Any:
        if frame.points is None:
            raise rs.BadInput("frame.points", None, "the two markers")
        return self.report(frame.points.copy())

    def report(self, points: Any) -> Any:
        visible = np.isfinite(points).all(axis=1)
        return rs.Markers(points, np.where(visible, 6.0, np.nan), np.where(visible, 1.0, 0.0))


@dataclass(frozen=True)
class WorkingEstimator(rs.Estimator):
    """Pixels of both markers as A [p₁ 1]ᵀ, by recursive least squares, with a prediction."""

    def init(self) -> Any:
        return np.zeros((4, 4)), 1e6 * np.eye(4), np.array([320.0, 100.0])

    def update(self, memory: Any, tool: Any, sample: Any) -> Any:
        A, P, _ = memory
        x = np.append(sample.p1, 1.0)
        gain = P @ x / (1.0 + x @ P @ x)
        A = A + np.outer(sample.points.ravel() - A @ x, gain)
        return A, P - np.outer(gain, P @ x), sample.o_c.copy()

    def markers_jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        return memory[0][:, :3]

    def jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        m = rs.shift_to_rcm(sample.points, sample.o_c)
        return rs.compute_features_jacobian(m) @ memory[0][:, :3]

    def predict(self, memory: Any, tool: Any, p1: Any) -> Any:
        return memory[0] @ np.append(p1, 1.0) - np.tile(memory[2], 2)


class WorkingFeatures(rs.FeatureVector):
    """Angle of the tool, and the coordinates of marker 1."""

    name = "working"
    components = "angle", "u1", "v1"
    units = "rad", "px", "px"

    def measure(self, markers: rs.MarkerPair) -> Any:
        (u1, v1), (u2, v2) = markers.points
        return np.array([np.arctan2(v2 - v1, u2 - u1), u1, v1])

    def jacobian(self, markers: rs.MarkerPair) -> Any:
        du, dv = markers.points[1] - markers.points[0]
        turn = np.array([-dv, du]) / (du**2 + dv**2)
        return np.array([[*-turn, *turn], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])


def check_moving_arm(make: Callable[[StepClock], Any]) -> None:
    clock = StepClock()
    rs.testing.check_arm(make(clock), clock, may_move=True)


def check_camera(make: Callable[[StepClock], Any]) -> None:
    clock = StepClock()
    rs.testing.check_camera(make(clock), clock)


def check_tracker(tracker: Any) -> None:
    rs.testing.check_tracker(tracker, rs.Frame(0, 0, 0, points=POINTS), POINTS)


def plant(kind: type[Any], **methods: Any) -> type[Any]:
    """Return the class of a working part with a planted fault."""
    return type("Mine", (kind,), methods)


def report_q(change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a `measure` that reports changed joints."""
    return lambda arm: WorkingArm.measure(arm)._replace(q=change(arm.q))


def report_time(change: Callable[[int], Any]) -> Callable[[Any], Any]:
    """Return a `measure` that reports a changed time."""
    return lambda arm: WorkingArm.measure(arm)._replace(time=change(arm.time))


def block(method: str, kind: type[Any]) -> Callable[..., Any]:
    """Return a method that takes 8 ms of the clock."""

    def blocking(part: Any, *arguments: Any) -> Any:
        part.clock.wait_until(part.clock.now() + 8 * MS)
        return getattr(kind, method)(part, *arguments)

    return blocking


def overwrite_joints(arm: Any) -> Any:
    """Report the joints in one array."""
    report = WorkingArm.measure(arm)
    arm.buffer = getattr(arm, "buffer", report.q)
    arm.buffer[:] = report.q
    return report._replace(q=arm.buffer)


def take_rates(factors: Any) -> Callable[..., Any]:
    """Return an `apply` that makes another rate of a commanded one, and does not report it."""

    def apply(arm: Any, command: rs.Command) -> Any:
        applied = WorkingArm.apply(arm, command)
        arm.rates = applied * factors
        return applied

    return apply


def alternate_time(arm: Any) -> Any:
    """Report every other time of two alternating ones."""
    arm.calls = getattr(arm, "calls", 0) + 1
    report = WorkingArm.measure(arm)
    return report._replace(time=report.time - 20 * MS * (arm.calls % 2))


def coast(arm: Any) -> None:
    """Switch the drive off at the deadline without stopping the joints."""
    deadline, rates = arm.deadline, arm.rates
    never_stop(arm)
    arm.deadline, arm.rates = deadline, rates
    arm.on = arm.on and arm.time <= deadline


def never_stop(arm: Any) -> None:
    """Advance without a watchdog."""
    arm.deadline = arm.clock.now() + MS
    WorkingArm.advance(arm)


def ignore_expiry(arm: Any, command: rs.Command) -> Any:
    arm.advance()
    return WorkingArm.apply(arm, replace(command, deadline=arm.clock.now() + 50 * MS))


def stay_on(arm: Any, command: rs.Command) -> Any:
    return WorkingArm.apply(arm, replace(command, enabled=True))


def halve_command(arm: Any, command: rs.Command) -> Any:
    applied = WorkingArm.apply(arm, command)
    command.rates[:] *= 0.5
    return applied


def count_ns(arm: Any) -> Any:
    raise ConnectionError("no answer")


ARM_FAULTS = {
    "list": ({"measure": report_q(list)}, "measure() must be ArmMeasurement"),
    "float32": (
        {"measure": report_q(np.float32)},
        "q as a writable float64 array in C order of shape (3,)",
    ),
    "shape": ({"measure": report_q(lambda q: np.append(q, 0.0))}, "in C order of shape (3,)"),
    "NaN": ({"measure": report_q(lambda q: q * np.nan)}, "[nan nan nan], expected finite joints"),
    "time as float": ({"measure": report_time(lambda t: t * 1e-9)}, "time in whole ns"),
    "time in s": ({"measure": report_time(lambda t: t // 10**9)}, "ns: it is in s, expected ns"),
    "time in ms": ({"measure": report_time(lambda t: t // MS)}, "ns: it is in ms, expected ns"),
    "old time": ({"measure": report_time(lambda t: t - 200 * MS)}, "it is 200 ms old"),
    "other clock": (
        {"measure": report_time(lambda t: t + 10**18)},
        "it is not a time of this clock, from which it differs by -1e+09 s",
    ),
    "constant time": ({"measure": report_time(lambda t: BOOT_NS + 40 * MS)}, "it is 170 ms old"),
    "time goes back": ({"measure": alternate_time}, ": it goes back"),
    "blocking": ({"measure": block("measure", WorkingArm)}, "measure() took 8.0 ms"),
    "exception": ({"measure": count_ns}, "measure() raised ConnectionError('no answer')"),
    "missing": ({"measure": None}, "measure() is missing"),
    "on": (
        {"measure": lambda arm: WorkingArm.measure(arm)._replace(enabled=True)},
        "reports the drive as on before enable()",
    ),
    "degrees": ({"measure": report_q(lambda q: q * [57.3, 57.3, 1.0])}, "these look like degrees"),
}
"""Planted faults of an arm that stands still, and what their sentences contain."""

MOTION_FAULTS = {
    "reports degrees": (
        {"measure": report_q(lambda q: (q - [0.6, 0.2, 0]) * [57.3, 57.3, 1.0])},
        " times as far: degrees instead of rad?",
    ),
    "reports m": ({"measure": report_q(lambda q: q * [1.0, 1.0, 1e-3])}, ": m instead of mm?"),
    "takes degrees/s": ({"apply": take_rates([1 / 57.3, 1, 1])}, "rates taken as degrees/s?"),
    "takes m/s": ({"apply": take_rates([1.0, 1.0, 1e3])}, "or rates taken as m/s?"),
    "opposite": ({"apply": take_rates([1.0, -1.0, 1.0])}, "-1 times as far: opposite direction"),
    "stands still": (
        {"apply": take_rates(np.array([0.0, 0.0, 0.0]))},
        "joint 1 moved by 0 where apply() returned rates of 0.0204 rad in all, 0 times",
    ),
    "returns degrees/s": (
        {"apply": lambda arm, command: np.degrees(WorkingArm.apply(arm, command))},
        "for commands of at most [0.05 0.05 5.  ] rad/s, rad/s, mm/s",
    ),
    "applies nothing": (
        {"apply": lambda arm, command: np.zeros(3)},
        "apply() applied none of the rate that was commanded for joint 1",
    ),
    "coasts": ({"advance": coast}, "reports joints that still move by [0. "),
    "crossed": (
        {"measure": report_q(lambda q: q[[1, 0, 2]].copy())},
        "apply() moved joint [2] by a rate that was commanded for joint 1",
    ),
    "never on": ({"enable": lambda arm: None}, "must report enabled = True within 2 s"),
    "overwritten": ({"measure": overwrite_joints}, "overwrote the array q of its previous report"),
    "no watchdog": ({"advance": never_stop}, "as on, 200 ms after the deadline of the last"),
    "expired": ({"apply": ignore_expiry}, "obeyed commands whose deadline had passed"),
    "not disabled": ({"apply": stay_on}, "left the drive on after commands with enabled = False"),
    "changed command": ({"apply": halve_command}, "changed command.rates in place"),
    "blocking": ({"apply": block("apply", WorkingArm)}, "apply() took 8.0 ms"),
    "None": ({"apply": lambda arm, command: None}, "apply() must be the joint rates"),
}
"""Planted faults that show in motion, and what their sentences contain."""


@pytest.mark.parametrize("fault", ARM_FAULTS)
def test_a_fault_of_an_arm_at_rest_is_named_and_nothing_moves(fault: str) -> None:
    methods, sentence = ARM_FAULTS[fault]
    commands: list[Any] = []
    watched = {"enable": lambda arm: commands.append("enable")}
    watched["apply"] = lambda arm, command: commands.append(command)
    clock = StepClock()
    with pytest.raises(rs.testing.ContractViolation) as found:
        rs.testing.check_arm(plant(WorkingArm, **watched, **methods)(clock), clock)
    assert str(found.value).startswith("Mine.measure() ") and sentence in str(found.value)
    assert commands == []


@pytest.mark.parametrize("fault", MOTION_FAULTS)
def test_a_fault_of_an_arm_in_motion_is_named_and_the_drive_is_disabled(fault: str) -> None:
    methods, sentence = MOTION_FAULTS[fault]
    clock, commands = StepClock(), []
    arm = plant(WorkingArm, **methods)(clock)
    apply = arm.apply
    arm.apply = lambda command: (commands.append(command), apply(command))[1]
    with pytest.raises(rs.testing.ContractViolation) as found:
        rs.testing.check_arm(arm, clock, may_move=True)
    assert str(found.value).startswith("Mine.") and sentence in str(found.value)
    assert not commands[-1].enabled and not commands[-1].rates.any()


def test_an_arm_moves_only_with_consent_and_by_small_slow_motions() -> None:
    clock = StepClock()
    arm, farthest = WorkingArm(clock), np.zeros(3)
    start = arm.q
    rs.testing.check_arm(arm, clock)
    assert (arm.q == start).all() and not arm.on
    apply = arm.apply

    def watch(command: rs.Command) -> Any:
        farthest[:] = np.maximum(farthest, np.abs(arm.q - start))
        assert (np.abs(command.rates) <= [0.05, 0.05, 5.0]).all()
        return apply(command)

    arm.apply = watch
    rs.testing.check_arm(arm, clock, may_move=True)
    assert not arm.on
    assert (farthest > [0.018, 0.018, 1.8]).all() and (farthest < [0.022, 0.022, 2.2]).all()


def test_an_interrupted_check_disables_the_drive() -> None:
    clock = StepClock()
    arm = WorkingArm(clock)
    measure, calls = arm.measure, []

    def interrupt() -> Any:
        calls.append(arm.on)
        if sum(calls) == 20:
            raise KeyboardInterrupt
        return measure()

    arm.measure = interrupt
    with pytest.raises(KeyboardInterrupt):
        rs.testing.check_arm(arm, clock, may_move=True)
    assert calls[-1] and not arm.on


def stamp(**changes: Any) -> Callable[..., Any]:
    """Return an `expose` that changes fields of a frame, given as functions of it."""

    def expose(camera: Any, number: int) -> Any:
        frame = WorkingCamera.expose(camera, number)
        return replace(frame, **{name: change(frame) for name, change in changes.items()})

    return expose


def overwrite_image(camera: Any, number: int) -> Any:
    camera.buffer = getattr(camera, "buffer", np.zeros((4, 6, 3), np.uint8))
    camera.buffer[:] = number % 251
    return camera.buffer


def renew_object(camera: Any) -> Any:
    """Return a new object for the same frame at every third call."""
    camera.calls = getattr(camera, "calls", 0) + 1
    frame = WorkingCamera.latest(camera)
    if camera.calls % 3 == 0:
        camera.frame = replace(frame)
    return camera.frame


def expose_slowly(camera: Any) -> Any:
    """Return one frame a second."""
    number = (camera.clock.now() - BOOT_NS) // 1_000_000_000
    if camera.frame is None or number > camera.frame.number:
        time = BOOT_NS + number * 1_000_000_000
        camera.frame = rs.Frame(number, time, time, image=camera.image(number))
    return camera.frame


CAMERA_FAULTS = {
    "no frame": ({"latest": lambda camera: None}, "latest() returned None for 5 s"),
    "image alone": ({"latest": lambda camera: np.zeros((4, 6, 3))}, "latest() must be a Frame"),
    "blocking": ({"latest": block("latest", WorkingCamera)}, "latest() took 8.0 ms"),
    "no exposure": ({"expose": stamp(exposure=lambda f: 0)}, "without exposure time: exposure = 0"),
    "equal exposures": (
        {"expose": stamp(exposure=lambda f: BOOT_NS)},
        f"returned the exposure {BOOT_NS} ns for frames",
    ),
    "exposures go back": (
        {"expose": stamp(exposure=lambda f: f.exposure - 20 * MS * (f.number % 2))},
        "with exposures that go back",
    ),
    "exposure after arrival": (
        {"expose": stamp(exposure=lambda f: f.arrival + 3 * MS)},
        "was exposed 3 ms after its arrival",
    ),
    "time as float": ({"expose": stamp(exposure=lambda f: f.exposure * 1e-9)}, "whole numbers"),
    "times in ms": (
        {"expose": stamp(exposure=lambda f: f.exposure // MS, arrival=lambda f: f.arrival // MS)},
        "it is in ms, expected ns",
    ),
    "exposure in µs": (
        {"expose": stamp(exposure=lambda f: f.exposure // 1000)},
        "returned the exposure",
    ),
    "other clock": (
        {"expose": stamp(arrival=lambda f: f.arrival + 10**18)},
        "it is not a time of this clock",
    ),
    "equal numbers": ({"expose": stamp(number=lambda f: 7)}, "expected numbers that rise"),
    "new object": (
        {"latest": lambda camera: replace(WorkingCamera.latest(camera))},
        "returned a new Frame at every call",
    ),
    "another object": ({"latest": renew_object}, "returned two objects for frame"),
    "few frames": ({"latest": expose_slowly}, "frames in 5 s, expected 8"),
    "points": (
        {"expose": stamp(image=lambda f: None, points=lambda f: np.zeros(4))},
        "returned points of shape (4,), expected (2, 2) of float64",
    ),
    "no image": ({"image": lambda camera, number: None}, "with neither image nor points"),
    "grey": ({"image": lambda c, n: np.zeros((4, 6), np.uint8)}, "image of shape (4, 6)"),
    "float image": ({"image": lambda c, n: np.zeros((4, 6, 3))}, "type float64, expected"),
    "overwritten": ({"image": overwrite_image}, "overwrote the image of an earlier frame"),
    "other size": (
        {"image": lambda c, n: np.zeros((4 + n % 2, 6, 3), np.uint8)},
        "images of different shapes",
    ),
}
"""Planted faults of a camera, and what their sentences contain."""


@pytest.mark.parametrize("fault", CAMERA_FAULTS)
def test_a_fault_of_a_camera_is_named(fault: str) -> None:
    methods, sentence = CAMERA_FAULTS[fault]
    with pytest.raises(rs.testing.ContractViolation) as found:
        check_camera(plant(WorkingCamera, **methods))
    assert str(found.value).startswith("Mine.latest() ") and sentence in str(found.value)


def report(**changes: Any) -> dict[str, Any]:
    """Return a `report` that changes fields of the markers, given as functions of them."""

    def change_report(tracker: Any, points: Any) -> Any:
        markers = WorkingTracker.report(tracker, points)
        return replace(markers, **{name: change(markers) for name, change in changes.items()})

    return {"report": change_report}


def hold_last(tracker: Any, points: Any) -> Any:
    """Report a lost marker where it was last."""
    tracker.last = points if np.isfinite(points).all() else getattr(tracker, "last", points)
    return WorkingTracker.report(tracker, tracker.last)


def drift(tracker: Any, points: Any) -> Any:
    """Report another position at each call, also after a reset."""
    tracker.calls = getattr(tracker, "calls", 0) + 1
    return WorkingTracker.report(tracker, points + 0.01 * tracker.calls)


def round_in_place(tracker: Any, frame: Any) -> Any:
    frame.points[:] += 0.1
    return WorkingTracker.report(tracker, frame.points.copy())


def reuse_array(tracker: Any, points: Any) -> Any:
    tracker.buffer = getattr(tracker, "buffer", np.empty((2, 2)))
    tracker.buffer[:] = points
    return WorkingTracker.report(tracker, tracker.buffer)


def freeze(markers: rs.Markers) -> Any:
    points = markers.points.copy()
    points.flags.writeable = False
    return points


TRACKER_FAULTS = {
    "list": (report(points=lambda m: m.points.tolist()), "find() must be Markers"),
    "float32": (report(points=lambda m: m.points.astype(np.float32)), "find() must be Markers"),
    "Fortran order": (report(points=lambda m: np.asfortranarray(m.points)), "array in C order"),
    "read-only": (
        report(points=freeze),
        "points as a writable float64 array in C order of shape (2, 2)",
    ),
    "shape": (report(points=lambda m: m.points.ravel()), "array in C order of shape (2, 2)"),
    "guess": (
        report(points=lambda m: np.nan_to_num(m.points)),
        "for an empty image, expected NaN, not a guess",
    ),
    "held": ({"report": hold_last}, "for an empty image, expected NaN, not a guess"),
    "swapped": (report(points=lambda m: m.points[::-1].copy()), "rows in swapped order"),
    "v, u": (report(points=lambda m: m.points[:, ::-1].copy()), "within 2 px"),
    "radius of absent": (report(radius=lambda m: np.full(2, 6.0)), "of absent markers"),
    "radius 0": (report(radius=lambda m: np.zeros(2)), "expected px above 0, or NaN if unknown"),
    "quality": (report(quality=lambda m: 100.0 * m.quality), "expected two numbers from 0 to 1"),
    "covariance": (report(covariance=lambda m: np.zeros((2, 2, 2))), "a covariance of shape"),
    "state": ({"report": drift}, "reset() leaves a state"),
    "changed frame": ({"find": round_in_place}, "changed the frame in place"),
    "overwritten": ({"report": reuse_array}, "overwrote the arrays of an earlier result"),
    "damaged": (
        {"find": lambda t, f: WorkingTracker.report(t, np.array(f.points, float))},
        "find() raised ",
    ),
}
"""Planted faults of a tracker, and what their sentences contain."""


@pytest.mark.parametrize("fault", TRACKER_FAULTS)
def test_a_fault_of_a_tracker_is_named(fault: str) -> None:
    methods, sentence = TRACKER_FAULTS[fault]
    with pytest.raises(rs.testing.ContractViolation) as found:
        check_tracker(plant(WorkingTracker, **methods)())
    assert str(found.value).startswith("Mine.") and sentence in str(found.value)


HIDDEN = [0]


def depend_on_calls(estimator: Any, memory: Any, tool: Any, sample: Any) -> Any:
    HIDDEN[0] += 1
    A, P, o_c = WorkingEstimator.update(estimator, memory, tool, sample)
    return A, P * (1.0 + 1e-3 * (HIDDEN[0] // 7)), o_c


def change_memory(estimator: Any, memory: Any, tool: Any, sample: Any) -> Any:
    """Change P in place, which changes Ĵ only at the next sample."""
    A, P, o_c = WorkingEstimator.update(estimator, memory, tool, sample)
    memory[1][:] = P
    return A, memory[1], o_c


def change_sample(estimator: Any, memory: Any, tool: Any, sample: Any) -> Any:
    memory = WorkingEstimator.update(estimator, memory, tool, sample)
    sample.points[:] -= sample.o_c
    return memory


def scale_jacobian(factors: Any) -> dict[str, Any]:
    def jacobian(estimator: Any, memory: Any, tool: Any, sample: Any) -> Any:
        return np.diag(factors) @ WorkingEstimator.jacobian(estimator, memory, tool, sample)

    return {"jacobian": jacobian}


def predict_raw(estimator: Any, memory: Any, tool: Any, p1: Any) -> Any:
    return memory[0] @ np.append(p1, 1.0)


def return_always(value: Any) -> Callable[..., Any]:
    return lambda *arguments: value


ESTIMATOR_FAULTS = {
    "shape": ({"jacobian": return_always(np.zeros((2, 3)))}, "jacobian returned an array of shape"),
    "NaN": ({"jacobian": return_always(np.full((3, 3), np.nan))}, "number that is not finite"),
    "exception": ({"update": lambda *_: {}["x"]}, "update() raised KeyError('x')"),
    "hidden state": ({"update": depend_on_calls}, "update() returned two results for one seq"),
    "memory": ({"update": change_memory}, "update() changed its memory in place"),
    "lost marker": (
        {
            "estimates_rcm": True,
            "tolerates_lost_marker": True,
            "imaged_rcm": lambda estimator, memory: (memory[2], np.eye(2)),
        },
        "filtered_markers() returned NaN for marker 1, which the class says it supplies",
    ),
    "sample": ({"update": change_sample}, "update() changed the sample in place"),
    "degrees": (
        scale_jacobian([57.3, 1.0, 1.0]),
        "times the true one in rad/mm: degrees instead of rad?",
    ),
    "per m": (scale_jacobian([1e3, 1e3, 1e3]), "times the true one in rad/mm"),
    "opposite": (scale_jacobian([1.0, -1.0, 1.0]), "a row of r that is -"),
    "not the derivative": (
        scale_jacobian([1.0, 1.0, 1.2]),
        "jacobian() is not the derivative of the features of its predict(): row 2",
    ),
    "not eq. (15)": (
        {**scale_jacobian([1.0, 1.2, 1.0]), "predict": rs.Estimator.predict},
        "jacobian() is not ∂y/∂m times its markers_jacobian(), eq. (15): row 1",
    ),
    "markers' Jacobian": (
        {"markers_jacobian": lambda e, memory, tool, sample: 1.1 * memory[0][:, :3]},
        "markers_jacobian() is not the derivative of its predict()",
    ),
    "raw prediction": ({"predict": predict_raw}, "raw px, expected px from the imaged RCM"),
}
"""Planted faults of an estimator, and what their sentences contain."""


@pytest.mark.parametrize("fault", ESTIMATOR_FAULTS)
def test_a_fault_of_an_estimator_is_named(fault: str) -> None:
    methods, sentence = ESTIMATOR_FAULTS[fault]
    with pytest.raises(rs.testing.ContractViolation) as found:
        rs.testing.check_estimator(plant(WorkingEstimator, **methods)())
    assert "Mine" in str(found.value) and sentence in str(found.value)


def measure_degrees(vector: Any, markers: Any) -> Any:
    return WorkingFeatures.measure(vector, markers) * [180.0 / np.pi, 1.0, 1.0]


def derive_degrees(vector: Any, markers: Any) -> Any:
    return np.diag([180.0 / np.pi, 1.0, 1.0]) @ WorkingFeatures.jacobian(vector, markers)


def move_markers(vector: Any, markers: Any) -> Any:
    features = WorkingFeatures.measure(vector, markers)
    markers.points[0] = features[1:]
    markers.sizes[:] = 0.0
    return features


def count_calls(vector: Any, markers: Any) -> Any:
    vector.calls = getattr(vector, "calls", 0) + 1
    return WorkingFeatures.measure(vector, markers) + vector.calls


FEATURE_BUFFER = np.zeros(3)


def reuse_features(vector: Any, markers: Any) -> Any:
    FEATURE_BUFFER[:] = WorkingFeatures.measure(vector, markers)
    return FEATURE_BUFFER


FEATURE_FAULTS = {
    "unit": ({"units": ("deg", "px", "px")}, "rad or px for each component"),
    "degrees": (
        {"measure": measure_degrees, "jacobian": derive_degrees},
        "for the component 'angle', which is declared in rad: degrees?",
    ),
    "shape": ({"measure": return_always(np.zeros(2))}, "expected an array of shape (3,)"),
    "shape of the Jacobian": (
        {"jacobian": return_always(np.zeros((3, 6)))},
        "expected an array of shape (3, 4)",
    ),
    "NaN": ({"measure": return_always(np.full(3, np.nan))}, "expected numbers"),
    "state": ({"measure": count_calls}, "returned two results for the same markers"),
    "overwritten": ({"measure": reuse_features}, "overwrote the array of an earlier result"),
    "derivative": ({"jacobian": return_always(np.ones((3, 4)))}, "derivative of its measure"),
    "exception": ({"measure": lambda *_: 1 / 0}, "ZeroDivisionError"),
    "markers": ({"measure": move_markers}, "measure() changed the markers in place"),
}
"""Planted faults of a feature vector, and what their sentences contain."""


@pytest.mark.parametrize("fault", FEATURE_FAULTS)
def test_a_fault_of_a_feature_vector_is_named(fault: str) -> None:
    methods, sentence = FEATURE_FAULTS[fault]
    with pytest.raises(rs.testing.ContractViolation) as found:
        rs.testing.check_feature_vector(plant(WorkingFeatures, **methods)())
    assert sentence in str(found.value)


@pytest.mark.parametrize(
    ("methods", "sentence"),
    [
        ({"now": lambda clock: 1.5}, "now() returned 1.5, expected whole ns"),
        ({"wait_until": lambda clock, time: None}, "wait_until() returned after 1e-06 ms"),
        (
            {"wait_until": lambda clock, time: setattr(clock, "time", time)},
            "went back after a wait for a past time",
        ),
    ],
    ids=("float", "stands still", "goes back"),
)
def test_a_fault_of_a_clock_is_named(methods: dict[str, Any], sentence: str) -> None:
    clock = plant(StepClock, **methods)()
    with pytest.raises(rs.testing.ContractViolation) as found:
        rs.testing.check_camera(WorkingCamera(clock), clock)
    assert str(found.value).startswith("Mine.") and sentence in str(found.value)


def test_working_parts_pass() -> None:
    check_moving_arm(WorkingArm)
    check_camera(WorkingCamera)
    check_tracker(WorkingTracker())
    rs.testing.check_estimator(WorkingEstimator())
    rs.testing.check_feature_vector(WorkingFeatures())
    assert WorkingFeatures.name not in FEATURE_VECTORS


@pytest.mark.parametrize("name", [*ESTIMATORS, "affine"])
def test_built_in_estimators_pass(name: str) -> None:
    estimator = {**ESTIMATORS, "affine": rs.AffineEstimator()}[name]
    rs.testing.check_estimator(estimator)
    rs.testing.check_estimator(estimator, rs.ScaledTool(scale=1.3))


@pytest.mark.parametrize("name", FEATURE_VECTORS)
def test_built_in_feature_vectors_pass(name: str) -> None:
    rs.testing.check_feature_vector(FEATURE_VECTORS[name])


def test_the_estimator_of_the_example_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    rs.testing.check_estimator(__import__("02_own_estimator").RLS())


@pytest.mark.parametrize("pictures", [False, True], ids=("points", "pictures"))
def test_the_simulated_devices_pass(pictures: bool) -> None:
    rig = rs.sim.Rig(seed=0, pictures=pictures)
    rs.testing.check_camera(rig.camera, rig.clock)
    frame, truth = rig.camera.latest(), rig.truth.pixels(rig.arm.q_true)
    if pictures:
        look = rs.tracking.MarkerAppearance()
        rs.testing.check_tracker(rs.tracking.ColourMarkers(look), frame, truth)
    else:
        rs.testing.check_tracker(rs.tracking.PointMarkers(), frame, truth)
        rs.testing.check_arm(rig.arm, rig.clock, may_move=True)


class InlineUdpArm(udp_arm.UdpArm):
    """Driver of the toy arm that exchanges datagrams with it in the same process."""

    def __init__(self, clock: StepClock) -> None:
        self.clock, self.toy = clock, ToyArm(clock.now())
        self._session, self._last, self._new = 0, None, udp_arm.threading.Event()
        self._send(ASK)

    def measure(self) -> rs.ArmMeasurement:
        self._send(ASK)
        return super().measure()

    def _send(self, kind: int, number: int = 0, rates: Any = udp_arm.REST) -> None:
        order = ToyOrder(kind, self._session, number, self.clock.now(), rates)
        self._take(self.toy.hear(sent(order), self.clock.now()))


def test_the_arm_of_the_example_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = StepClock()
    time = SimpleNamespace(monotonic_ns=clock.now, monotonic=lambda: clock.now() * 1e-9)
    monkeypatch.setattr(udp_arm, "time", time)
    rs.testing.check_arm(InlineUdpArm(clock), clock, may_move=True)


OWN_DEVICES = """
from types import SimpleNamespace

import own_devices  # hides the simulator
import rcmservo as rs


class Clock:
    time = 5_000_000_000_000

    def now(self):
        self.time += 1
        return self.time

    def wait_until(self, time):
        self.time = max(self.time, time)
        arm.measure()  # moves the tool in the memory that the camera reads


class PunctualArm(own_devices.OwnArm):
    def apply(self, command):
        if clock.now() > command.deadline:
            return self.rates.copy()
        return super().apply(command)


clock = Clock()
own_devices.time = SimpleNamespace(monotonic_ns=clock.now)
memory = bytearray(32)
arm = own_devices.OwnArm(memory)
rs.testing.check_camera(own_devices.OwnCamera(memory), clock)
rs.testing.check_arm(arm, clock)
try:
    rs.testing.check_arm(arm, clock, may_move=True)
except rs.testing.ContractViolation as found:
    print(found)
own_devices.WATCHDOG_NS = 50_000_000
arm = PunctualArm(memory)
rs.testing.check_arm(arm, clock, may_move=True)
print("the punctual arm passes")
"""


def test_the_devices_of_the_page_pass_apart_from_the_slow_watchdog(tmp_path: Path) -> None:
    """The arm's watchdog of 1 s tolerates a busy computer; the check finds it."""
    script = tmp_path / "script.py"
    script.write_text(OWN_DEVICES)
    command, environment = [sys.executable, str(script)], make_environment()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found, passed = done.stdout.splitlines()
    assert found.startswith("OwnArm.measure() reports the drive as on, 200 ms after the deadline")
    assert passed == "the punctual arm passes"
