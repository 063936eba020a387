"""Guard between the servo and a user-defined estimator.

Before the drive is enabled, `check_estimator` calls the estimator with made-up samples and refuses
it if it fails. In motion a failure becomes a Ĵ that is not finite and a message: the servo enters
FAULT in the same tick, and the loop never ends by an exception.
"""

from collections.abc import Iterator
from time import perf_counter_ns
from typing import Any, NamedTuple, final

import numpy as np

from rcmservo.errors import RcmServoError, shorten_to_line
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats

UNKNOWN_JACOBIAN = np.full((4, 3), np.nan)
"""∂m/∂p₁ (4, 3) that is not estimated."""

TRIAL_SAMPLES = 30
"""Number of made-up samples with which an estimator is checked."""


class UnusableEstimator(RcmServoError):
    """Error of a user-defined estimator, in one sentence that names it."""


class GuardedMemory(NamedTuple):
    """Memory of a user-defined estimator and its checked results for the newest frame.

    By default the results are unknown.

    Parameters
    ----------
    memory : Any
        Memory of the estimator itself.
    J_hat : Floats
        Ĵ (3, 3) in rad/mm, px/mm, px/mm; NaN after a failure.
    points : Floats
        Markers (2, 2) in raw px as the estimator locates them.
    markers_jacobian : Floats
        ∂m/∂p₁ (4, 3) in px/mm; NaN after a failure or if the estimator does not estimate it.
    sizes_jacobian : Floats
        ∂R/∂p₁ (2, 3) in px/mm; NaN after a failure or if the estimator does not estimate it.
    imaged_rcm : tuple[Floats, Floats] or None
        Imaged RCM (2,) in px and its covariance (2, 2) in px²; None if eq. (16) computes it.
    numbers : Floats
        Numbers (n,) of the memory that a record stores.
    failure : str
        Message of the failure; empty without one.
    """

    memory: Any = None
    J_hat: Floats = np.full((3, 3), np.nan)
    points: Floats = np.full((2, 2), np.nan)
    markers_jacobian: Floats = UNKNOWN_JACOBIAN
    sizes_jacobian: Floats = UNKNOWN_JACOBIAN[:2]
    imaged_rcm: tuple[Floats, Floats] | None = None
    numbers: Floats = np.empty(0)
    failure: str = ""


def format_class_name(kind: type[Any]) -> str:
    """Return the name of a class as module:class."""
    return f"{kind.__module__}:{kind.__qualname__}"


def format_class_name_of(estimator: object) -> str:
    """Return the name of an estimator's class as module:class."""
    return format_class_name(type(estimator))


def guard_estimator(estimator: Estimator) -> Estimator:
    """Return the estimator that the servo calls: a user-defined one in an `EstimatorGuard`."""
    return estimator if _is_built_in(type(estimator)) else EstimatorGuard(estimator)


def is_compiled(kind: type[Any]) -> bool:
    """Return True if estimators of a class are part of the compiled tick.

    These are the estimators of this package that declare a kernel themselves. Others do not
    compile, because the cache of compiled code does not notice edits in other files.
    """
    return _is_built_in(kind) and "kernel" in vars(kind)


def find_kernel(estimator: Estimator) -> Any:
    """Return the compiled form of an estimator; None if it does not compile."""
    compiled_estimator: Any = estimator
    return compiled_estimator.kernel if is_compiled(type(estimator)) else None


def _is_built_in(kind: type[Any]) -> bool:
    return kind.__module__.startswith("rcmservo.")


def read_failure(memory: object) -> str:
    """Return the failure message of an estimator with this memory; empty without a failure."""
    return memory.failure if isinstance(memory, GuardedMemory) else ""


class EstimatorGuard(Estimator):
    """Estimator that calls a user-defined one and checks its results.

    ``slowest_ns`` is the longest time in ns that the estimator has taken for a frame.
    """

    name = "own"

    def __init__(self, own: Estimator) -> None:
        self.estimator, self.slowest_ns = own, 0

    def init(self) -> GuardedMemory:
        unknown = GuardedMemory()
        try:
            memory = self._call("init")
            numbers = self._call_for_numbers(memory)
            return unknown._replace(memory=memory, J_hat=np.zeros((3, 3)), numbers=numbers)
        except UnusableEstimator as error:
            return unknown._replace(failure=str(error))

    def update(self, memory: GuardedMemory, tool: Tool, sample: Sample) -> GuardedMemory:
        started = perf_counter_ns()
        try:
            return self._update_checked(memory, tool, sample)
        except UnusableEstimator as error:
            points, rcm, numbers = memory.points, memory.imaged_rcm, memory.numbers
            failed = GuardedMemory(memory.memory, points=points, imaged_rcm=rcm, numbers=numbers)
            return failed._replace(failure=str(error))
        finally:
            self.slowest_ns = max(self.slowest_ns, perf_counter_ns() - started)

    def _update_checked(self, before: GuardedMemory, tool: Tool, sample: Sample) -> GuardedMemory:
        """Update the estimator and return its results; raise `UnusableEstimator` if it fails."""
        p1, points, o_c, dt, sizes = sample
        sample = Sample(p1.copy(), points.copy(), o_c.copy(), dt, sizes.copy())
        memory = self._call("update", before.memory, tool, sample)
        points = self._call_for_finite("filtered_markers", (2, 2), memory, tool, sample)
        rcm = self._call_for_imaged_rcm(memory)
        if rcm is not None:
            sample = sample._replace(points=points.copy(), o_c=rcm[0].copy())
        J_hat = self._call_for_finite("jacobian", (3, 3), memory, tool, sample)
        results = GuardedMemory(memory, J_hat, points, imaged_rcm=rcm)
        if rcm is not None or self.estimator.has_markers_jacobian:
            jacobian = self._call_for_finite("markers_jacobian", (4, 3), memory, tool, sample)
            results = results._replace(markers_jacobian=jacobian)
        if self.estimator.has_sizes_jacobian:
            jacobian = self._call_for_finite("sizes_jacobian", (2, 3), memory, tool, sample)
            results = results._replace(sizes_jacobian=jacobian)
        self._call_for_prediction(memory, tool, sample.p1)
        numbers = self._call_for_numbers(memory)
        if numbers.shape != before.numbers.shape:
            failure = f"returned {len(numbers)} numbers, expected {before.numbers.size} as before"
            raise self._make_error("recorded_numbers", failure)
        return results._replace(numbers=numbers)

    def jacobian(self, memory: GuardedMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat

    def filtered_markers(self, memory: GuardedMemory, tool: Tool, sample: Sample) -> Floats:
        return sample.points if memory.failure else memory.points

    def markers_jacobian(self, memory: GuardedMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.markers_jacobian

    def sizes_jacobian(self, memory: GuardedMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.sizes_jacobian

    def imaged_rcm(self, memory: GuardedMemory) -> tuple[Floats, Floats] | None:
        return memory.imaged_rcm

    def predict(self, memory: GuardedMemory, tool: Tool, p1: Floats) -> Floats | None:
        try:
            return self._call_for_prediction(memory.memory, tool, p1.copy())
        except UnusableEstimator:  # `update` has reported it
            return None

    def recorded_numbers(self, memory: GuardedMemory) -> Floats | None:
        return memory.numbers if memory.numbers.size else None

    def _call_for_imaged_rcm(self, memory: Any) -> tuple[Floats, Floats] | None:
        if not self.estimator.estimates_rcm:
            return None
        value = self._call("imaged_rcm", memory)
        try:
            o_c, covariance = (np.array(array, dtype=np.float64) for array in value)
        except (TypeError, ValueError) as error:
            failure = (
                f"returned {shorten_to_line(repr(value))}, expected a point and its covariance"
            )
            raise self._make_error("imaged_rcm", failure) from error
        if o_c.shape != (2,) or covariance.shape != (2, 2):
            failure = f"returned arrays of shape {o_c.shape} and {covariance.shape}"
            raise self._make_error("imaged_rcm", f"{failure}, expected (2,) and (2, 2)")
        self._require_finite("imaged_rcm", o_c)
        return o_c, covariance

    def _call_for_prediction(self, memory: Any, tool: Tool, p1: Floats) -> Floats | None:
        if type(self.estimator).predict is Estimator.predict:
            return None
        return self._call_for_array("predict", (4,), memory, tool, p1)

    def _call_for_numbers(self, memory: Any) -> Floats:
        if type(self.estimator).recorded_numbers is Estimator.recorded_numbers:
            return np.empty(0)
        return self._call_for_array("recorded_numbers", (-1,), memory)

    def _call_for_finite(self, method: str, shape: tuple[int, ...], *arguments: Any) -> Floats:
        array = self._call_for_array(method, shape, *arguments)
        self._require_finite(method, array)
        return array

    def _call_for_array(self, method: str, shape: tuple[int, ...], *arguments: Any) -> Floats:
        """Return the result of a method as an array of this shape; -1 stands for any length."""
        value = self._call(method, *arguments)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            failure = f"returned {shorten_to_line(repr(value))}, expected numbers"
            raise self._make_error(method, failure) from error
        if array.shape != tuple(array.size if n < 0 else n for n in shape):
            failure = f"returned an array of shape {array.shape}, expected {shape}"
            raise self._make_error(method, failure)
        return array

    def _call(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self.estimator, method)(*arguments)
        except Exception as error:  # of any kind: the loop must reach its fault
            raise self._make_error(method, f"raised {shorten_to_line(repr(error))}") from error

    def _require_finite(self, method: str, array: Floats) -> None:
        if not np.isfinite(array).all():
            raise self._make_error(method, "returned a number that is not finite")

    def _make_error(self, method: str, failure: str) -> UnusableEstimator:
        return UnusableEstimator(
            f"estimator {format_class_name_of(self.estimator)}: its {method} {failure}"
        )


@final
class StrictGuard(EstimatorGuard):
    """Guard for use without motion: it raises the failures of the estimator."""

    def update(self, memory: GuardedMemory, tool: Tool, sample: Sample) -> GuardedMemory:
        return self._update_checked(memory, tool, sample)


def guard_strictly(estimator: Estimator) -> Estimator:
    """Return a user-defined estimator in a `StrictGuard`, a built-in one unchanged."""
    return estimator if _is_built_in(type(estimator)) else StrictGuard(estimator)


def reset_slowest(estimator: Estimator) -> None:
    """Discard the longest time of a guarded estimator after a warm-up, which delays no motion."""
    if isinstance(estimator, EstimatorGuard):
        estimator.slowest_ns = 0


def check_estimator(estimator: object, tool: Tool) -> None:
    """Call a user-defined estimator with made-up samples before the drive is enabled.

    Raises
    ------
    UnusableEstimator
        If the object is no estimator, fails, or is not pure.
    """
    if not isinstance(estimator, Estimator):
        raise UnusableEstimator(
            f"estimator {format_class_name_of(estimator)}: it must derive from rcmservo.Estimator"
        )
    guard = guard_strictly(estimator)
    if not isinstance(guard, EstimatorGuard):
        return
    memories, results = [guard.init()], list[bytes]()
    samples = list(make_trial_samples(tool))
    for sample in samples:
        memories.append(guard.update(_require_usable(memories[-1]), tool, sample))
        results.append(_read_results(_require_usable(memories[-1])))
    for memory, sample, result in zip(memories[:-1], samples, results, strict=True):
        if _read_results(guard.update(memory, tool, sample)) != result:
            raise UnusableEstimator(
                f"estimator {format_class_name_of(estimator)}: its update must be pure, but "
                "returned two results for one sample: does it change its memory in place?"
            )


def _require_usable(memory: GuardedMemory) -> GuardedMemory:
    if memory.failure:
        raise UnusableEstimator(memory.failure)
    return memory


def _read_results(memory: GuardedMemory) -> bytes:
    """Return the results for a frame, to compare them bit by bit."""
    results = memory.J_hat, memory.points, memory.markers_jacobian, memory.numbers
    return b"".join(array.tobytes() for array in results)


def make_trial_samples(tool: Tool) -> Iterator[Sample]:
    """Return samples of a tool that moves on a curve before a camera, 100 mm from the RCM."""
    for i in range(TRIAL_SAMPLES):
        p1 = np.array([10.0 * np.sin(0.3 * i), 10.0 * np.cos(0.2 * i), 100.0 + 0.5 * i])
        yield make_trial_sample(tool, p1, 1.0 / 60.0 if i else 0.0)


def make_trial_sample(tool: Tool, p1: Floats, dt: float) -> Sample:
    """Return the sample of the made-up camera for p₁ (3,) mm, without noise."""
    o_c = np.array([320.0, 100.0])
    both = np.stack([p1, tool.second_marker(p1)])
    depth = 1.0 + 0.002 * both[:, 1]
    points = o_c + 3.0 * both[:, [0, 2]] / depth[:, None]
    return Sample(p1, points, o_c, dt, 10.0 / depth)
