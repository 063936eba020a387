"""Errors of a user-defined estimator.

The servo refuses it before the drive is enabled, or enters FAULT in the same tick, with a message
that names it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import Laboratory, make_laboratory
from rcmservo.interfaces import Floats
from rcmservo.recording.outcome import OutcomeCollector
from rcmservo.servo import user_estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import EstimatorGuard, UnusableEstimator, check_estimator

TOOL = rs.RigidTool(spacing=30.0)
FAILURES = {
    "raises": ("update", lambda: 1 / 0, "raised ZeroDivisionError('division by zero')"),
    "shape of the Jacobian": (
        "jacobian",
        lambda: np.zeros((2, 3)),
        "returned an array of shape (2, 3), expected (3, 3)",
    ),
    "no Jacobian": ("jacobian", lambda: None, "returned an array of shape (), expected (3, 3)"),
    "text": ("jacobian", lambda: "J", "returned 'J', expected numbers"),
    "shape of the prediction": (
        "predict",
        lambda: np.zeros(3),
        "returned an array of shape (3,), expected (4,)",
    ),
    "no imaged RCM": (
        "imaged_rcm",
        lambda: None,
        "returned None, expected a point and its covariance",
    ),
    "shape of the covariance": (
        "imaged_rcm",
        lambda: (np.zeros(2), np.zeros(2)),
        "returned arrays of shape (2,) and (2,), expected (2,) and (2, 2)",
    ),
    "non-finite imaged RCM": (
        "imaged_rcm",
        lambda: (np.full(2, np.nan), np.eye(2)),
        "is not finite",
    ),
    "non-finite motion": ("markers_jacobian", lambda: np.full((4, 3), np.nan), "is not finite"),
    "shape of the motion": (
        "markers_jacobian",
        lambda: np.zeros((2, 3)),
        "returned an array of shape (2, 3), expected (4, 3)",
    ),
    "shape of the motion of sizes": (
        "sizes_jacobian",
        lambda: np.zeros(3),
        "returned an array of shape (3,), expected (2, 3)",
    ),
    "non-finite motion of sizes": (
        "sizes_jacobian",
        lambda: np.full((2, 3), np.nan),
        "is not finite",
    ),
    "shape of the recorded memory": (
        "recorded_numbers",
        lambda: np.zeros((2, 2)),
        "returned an array of shape (2, 2)",
    ),
    "init raises": ("init", lambda: {}["x"], "raised KeyError('x')"),
}
IMAGED_RCM = np.array([320.0, 100.0])
IN_MOTION = [name for name in FAILURES if name != "init raises"]


@dataclass(frozen=True)
class Faulty(rs.Estimator):
    """Default estimator of which one method fails after a number of frames."""

    failure: str = ""
    after: int = 0

    name = "faulty"
    predicts_markers = True

    @property
    def estimates_rcm(self) -> bool:
        return self.failure in FAILURES and FAILURES[self.failure][0] in (
            "imaged_rcm",
            "markers_jacobian",
        )

    def _fails(self, method: str, count: int) -> bool:
        return (
            self.failure in FAILURES and FAILURES[self.failure][0] == method and count > self.after
        )

    def init(self) -> Any:
        if self._fails("init", 1):
            return FAILURES[self.failure][1]()
        return 0, rs.ProjectionEstimator().init()

    def update(self, memory: Any, tool: Any, sample: Any) -> Any:
        count = memory[0] + 1
        if self._fails("update", count):
            return FAILURES[self.failure][1]()
        if self.estimates_rcm:  # then eq. (16) is not used
            sample = sample._replace(o_c=IMAGED_RCM)
        return count, rs.ProjectionEstimator().update(memory[1], tool, sample)

    def jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        if self._fails("jacobian", memory[0]):
            return FAILURES[self.failure][1]()
        return rs.ProjectionEstimator().jacobian(memory[1], tool, sample)

    def imaged_rcm(self, memory: Any) -> Any:
        if self._fails("imaged_rcm", memory[0]):
            return FAILURES[self.failure][1]()
        return IMAGED_RCM, np.eye(2)

    def markers_jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        if self._fails("markers_jacobian", memory[0]):
            return FAILURES[self.failure][1]()
        return np.arange(1.0, 13.0).reshape(4, 3)

    def sizes_jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        if self._fails("sizes_jacobian", memory[0]):
            return FAILURES[self.failure][1]()
        return np.ones((2, 3))

    def predict(self, memory: Any, tool: Any, p1: Floats) -> Any:
        if self._fails("predict", memory[0]):
            return FAILURES[self.failure][1]()
        return rs.ProjectionEstimator().predict(memory[1], tool, p1)

    def recorded_numbers(self, memory: Any) -> Any:
        if self._fails("recorded_numbers", memory[0]):
            return FAILURES[self.failure][1]()
        return memory[1].a_hat


@dataclass(frozen=True)
class Impure(Faulty):
    """Estimator whose update changes its memory in place."""

    def init(self) -> Any:
        return [np.zeros((3, 3))]

    def update(self, memory: Any, tool: Any, sample: Any) -> Any:
        memory[0] = memory[0] + 1.0
        return memory

    def jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        return memory[0]

    def recorded_numbers(self, memory: Any) -> Any:
        return memory[0].ravel()

    def predict(self, memory: Any, tool: Any, p1: Floats) -> Any:
        return np.zeros(4)


@dataclass(frozen=True)
class SharedImpure(Impure):
    """Estimator that returns the array that it changed: old results change with it."""

    def init(self) -> Any:
        return np.zeros((3, 3))

    def update(self, memory: Any, tool: Any, sample: Any) -> Any:
        memory[:] = 0.5 * memory + 0.5 * np.outer(sample.p1, sample.p1)
        return memory

    def jacobian(self, memory: Any, tool: Any, sample: Any) -> Any:
        return memory

    def recorded_numbers(self, memory: Any) -> Any:
        return memory.ravel()


@pytest.mark.parametrize("failure", FAILURES)
def test_an_estimator_that_fails_from_the_start_is_refused_before_the_drive_is_enabled(
    failure: str, lab: Laboratory
) -> None:
    method, _, sentence = FAILURES[failure]
    servo = lab.servo(estimator=Faulty(failure))
    with pytest.raises(UnusableEstimator) as refused:
        next(rs.servo_ticks(lab.plant, servo, lab.target, 1.0))
    assert sentence in str(refused.value)
    assert f"estimator {__name__}:Faulty: its {method} " in str(refused.value)
    assert not lab.plant.read().enabled


def test_an_object_that_is_no_estimator_or_not_pure_or_not_finite_is_refused() -> None:
    with pytest.raises(UnusableEstimator, match=r"builtins:int: it must derive from rcmservo\.Est"):
        check_estimator(3, TOOL)
    with pytest.raises(UnusableEstimator, match=r"Impure: its update must be pure"):
        check_estimator(Impure(), TOOL)
    with pytest.raises(UnusableEstimator, match=r"SharedImpure: its update must be pure"):
        check_estimator(SharedImpure(), TOOL)
    with pytest.MonkeyPatch.context() as other:
        other.setitem(FAILURES, "nan", ("jacobian", lambda: np.full((3, 3), np.nan), ""))
        with pytest.raises(
            UnusableEstimator, match=r"Faulty: its jacobian returned a number that is not finite"
        ):
            check_estimator(Faulty("nan"), TOOL)


def test_working_estimators_are_accepted() -> None:
    check_estimator(Faulty(), TOOL)
    check_estimator(rs.FlowEstimator(), TOOL)


@pytest.mark.parametrize("failure", IN_MOTION)
def test_a_failure_in_motion_is_a_fault_in_the_same_tick(failure: str, lab: Laboratory) -> None:
    method, _, sentence = FAILURES[failure]
    servo = lab.servo(estimator=Faulty(failure, after=40))
    judge, counts = OutcomeCollector(servo, lab.target), []
    for tick in rs.servo_ticks(lab.plant, servo, lab.target, 6.0):
        judge.add(tick)
        counts.append(tick.state.estimation.memory.memory[0])
    final_state = tick.state
    assert (final_state.phase, final_state.cause) == (rs.Phase.FAULT, rs.Cause.ESTIMATOR_FAILED)
    command = final_state.command
    assert counts[-2] == 40 and not command.enabled and not command.rates.any()
    for message in (final_state.text, judge.compute_result().cause):
        assert f"estimator {__name__}:Faulty: its {method} " in message and sentence in message


def test_the_guard_does_not_change_the_commands(lab: Laboratory) -> None:
    second_lab = make_laboratory()
    guarded = lab.run(lab.servo(estimator=Faulty()), 2.5)
    built_in = second_lab.run(second_lab.servo(estimator=rs.ProjectionEstimator()), 2.5)
    assert list(map(read_rates, guarded)) == list(map(read_rates, built_in))


def read_rates(tick: tuple[Any, rs.State]) -> bytes:
    return tick[1].command.rates.tobytes()


def test_built_in_estimators_are_called_without_a_guard(lab: Laboratory) -> None:
    estimator = rs.ProjectionEstimator()
    assert lab.servo(estimator=estimator).guarded_estimator is estimator
    assert isinstance(lab.servo(estimator=Faulty()).guarded_estimator, EstimatorGuard)


@pytest.mark.parametrize(
    ("milliseconds", "cause"), [(20, rs.Cause.OVERRUN), (70, rs.Cause.DRIVE_OFF)]
)
def test_a_slow_estimator_is_stopped_by_the_overrun_rule_or_the_watchdog_and_named(
    milliseconds: int, cause: rs.Cause, lab: Laboratory, monkeypatch: pytest.MonkeyPatch
) -> None:
    servo, spent = lab.servo(estimator=Faulty()), [0]
    servo.warm_up()
    original = Faulty.update

    def slow(self: Faulty, memory: Any, tool: Any, sample: Any) -> Any:
        if memory[0] > 100:
            spent[0] += milliseconds * 1_000_000
            lab.plant.clock.wait_until(lab.plant.clock.now() + milliseconds * 1_000_000)
        return original(self, memory, tool, sample)

    monkeypatch.setattr(Servo, "warm_up", lambda self: None)
    monkeypatch.setattr(Faulty, "update", slow)
    monkeypatch.setattr(user_estimator, "perf_counter_ns", lambda: spent[0])
    judge = OutcomeCollector(servo, lab.target)
    for tick in rs.servo_ticks(lab.plant, servo, lab.target, 6.0):
        judge.add(tick)
    assert tick.state.cause is cause
    message = judge.compute_result().cause
    assert cause.value in message
    assert f"estimator {__name__}:Faulty took up to {milliseconds}.0 ms for a frame" in message
