"""An estimator that a user has made, as the servo calls it: what it does wrong is found, named, and
never ends the loop.

Before the drive is on it is tried on made-up samples, and refused where it fails. In motion its
failure becomes a Ĵ that is not finite, and a sentence: a fault in the same tick.
"""

from collections.abc import Iterator
from time import perf_counter_ns
from typing import Any, NamedTuple, final

import numpy as np

from rcmservo.errors import RcmServoError, one_line
from rcmservo.estimation.base import CompiledEstimator, Estimator, Sample
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats

NOTHING, NOWHERE = np.empty(0), np.full((2, 2), np.nan)
LOST = np.full((4, 3), np.nan)
TRIES = 30
"""Made-up samples that an estimator is tried on."""


class UnusableEstimator(RcmServoError):
    """What an estimator does wrong, in one sentence that names it."""


class Guarded(NamedTuple):
    """What an estimator remembers, and what came of it at the newest frame.

    Parameters
    ----------
    memory : Any
        Its own.
    J_hat : Floats
        Ĵ (3, 3) as it gave it; NaN where it failed.
    points : Floats
        Where it has the markers (2, 2) px.
    motion : Floats
        ∂m/∂p₁ (4, 3) where it tells it; NaN elsewhere, and where it failed.
    size_motion : Floats
        ∂R/∂p₁ (2, 3) where it tells it; NaN elsewhere, and where it failed.
    placed : tuple[Floats, Floats] or None
        Where it has the imaged RCM (2,) px, and the covariance (2, 2) px²; None where eq. (16) is
        to tell it.
    numbers : Floats
        What a record keeps of its memory (n,).
    failure : str
        What it did wrong; empty while all is well.
    """

    memory: Any
    J_hat: Floats
    points: Floats
    motion: Floats
    size_motion: Floats
    placed: tuple[Floats, Floats] | None
    numbers: Floats
    failure: str


def name_of_class(kind: type[Any]) -> str:
    """A class as module:class."""
    return f"{kind.__module__}:{kind.__qualname__}"


def called(estimator: object) -> str:
    """An estimator's class as module:class."""
    return name_of_class(type(estimator))


def learner(estimator: Estimator) -> Estimator:
    """The estimator as the servo calls it: ours as it is, a user's own through a guard."""
    return estimator if _is_built_in(type(estimator)) else Guard(estimator)


def compiles(kind: type[Any]) -> bool:
    """Return whether estimators of a class are part of the compiled tick: those of this package
    that declare a kernel themselves. The cache of compiled code sees no edit of other files.
    """
    return _is_built_in(kind) and "kernel" in vars(kind)


def kernel_of(estimator: Estimator) -> Any:
    """Return the compiled form of an estimator; None where it does not compile."""
    if compiles(type(estimator)) and isinstance(estimator, CompiledEstimator):
        return estimator.kernel
    return None


def _is_built_in(kind: type[Any]) -> bool:
    return kind.__module__.startswith("rcmservo.")


def failure_of(memory: object) -> str:
    """What the estimator with this memory did wrong at the newest frame; empty if nothing."""
    return memory.failure if isinstance(memory, Guarded) else ""


def _knowing_nothing(memory: Any, J_hat: float, numbers: Floats, failure: str) -> Guarded:
    """The same before the first frame, with this number all over Ĵ."""
    J = np.full((3, 3), J_hat)
    return Guarded(memory, J, NOWHERE, LOST, LOST[:2], None, numbers, failure)


class Guard(Estimator):
    """Calls a user's estimator, and judges what it gives.

    ``slowest`` is the longest time, ns, that it has taken for a frame.
    """

    name = "own"

    def __init__(self, own: Estimator) -> None:
        self.own, self.slowest = own, 0

    def init(self) -> Guarded:
        try:
            memory = self._of("init")
            return _knowing_nothing(memory, 0.0, self._numbers(memory), "")
        except UnusableEstimator as error:
            return _knowing_nothing(None, np.nan, NOTHING, str(error))

    def update(self, memory: Guarded, tool: Tool, sample: Sample) -> Guarded:
        started = perf_counter_ns()
        try:
            return self._updated(memory, tool, sample)
        except UnusableEstimator as error:
            lost = {"J_hat": LOST[:3], "motion": LOST, "size_motion": LOST[:2]}
            return memory._replace(**lost, failure=str(error))
        finally:
            self.slowest = max(self.slowest, perf_counter_ns() - started)

    def _updated(self, before: Guarded, tool: Tool, sample: Sample) -> Guarded:
        p1, points, o_c, dt, sizes = sample
        sample = Sample(p1.copy(), points.copy(), o_c.copy(), dt, sizes.copy())
        memory = self._of("update", before.memory, tool, sample)
        points = self._array("located", (2, 2), memory, tool, sample)
        if not np.isfinite(points).all():
            raise self._wrong("located", "is not finite")
        placed = self._placed(memory)
        if placed is not None:
            sample = sample._replace(points=points.copy(), o_c=placed[0].copy())
        J_hat = self._array("jacobian", (3, 3), memory, tool, sample)
        if not np.isfinite(J_hat).all():
            raise self._wrong("jacobian", "is not finite")
        asked = placed is not None or self.own.tells_motion
        motion = self._motion("motion", 4, memory, tool, sample) if asked else LOST
        asked = self.own.tells_size_motion
        sizes = self._motion("size_motion", 2, memory, tool, sample) if asked else LOST[:2]
        self._model(memory, tool, sample.p1)
        numbers = self._numbers(memory)
        if numbers.shape != before.numbers.shape:
            raise self._wrong(
                "remembered", f"gave {len(numbers)} numbers after {before.numbers.size}"
            )
        return Guarded(memory, J_hat, points, motion, sizes, placed, numbers, "")

    def _motion(self, method: str, rows: int, memory: Any, tool: Tool, sample: Sample) -> Floats:
        motion = self._array(method, (rows, 3), memory, tool, sample)
        if not np.isfinite(motion).all():
            raise self._wrong(method, "is not finite")
        return motion

    def jacobian(self, memory: Guarded, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat

    def located(self, memory: Guarded, tool: Tool, sample: Sample) -> Floats:
        return sample.points if memory.failure else memory.points

    def motion(self, memory: Guarded, tool: Tool, sample: Sample) -> Floats:
        return memory.motion

    def size_motion(self, memory: Guarded, tool: Tool, sample: Sample) -> Floats:
        return memory.size_motion

    def imaged_rcm(self, memory: Guarded) -> tuple[Floats, Floats] | None:
        return memory.placed

    def predict(self, memory: Guarded, tool: Tool, p1: Floats) -> Floats | None:
        try:
            return self._model(memory.memory, tool, p1.copy())
        except UnusableEstimator:  # update has told it
            return None

    def remembered(self, memory: Guarded) -> Floats | None:
        return memory.numbers if memory.numbers.size else None

    def _placed(self, memory: Any) -> tuple[Floats, Floats] | None:
        if not self.own.places_rcm:
            return None
        value = self._of("imaged_rcm", memory)
        try:
            place, covariance = (np.array(part, dtype=np.float64) for part in value)
        except (TypeError, ValueError) as error:
            what = f"gave {one_line(repr(value))} instead of a place and its covariance"
            raise self._wrong("imaged_rcm", what) from error
        if place.shape != (2,) or covariance.shape != (2, 2):
            what = f"gave numbers of shape {place.shape} and {covariance.shape}"
            raise self._wrong("imaged_rcm", f"{what}, not (2,) and (2, 2)")
        if not np.isfinite(place).all():
            raise self._wrong("imaged_rcm", "is not finite")
        return place, covariance

    def _model(self, memory: Any, tool: Tool, p1: Floats) -> Floats | None:
        if type(self.own).predict is Estimator.predict:
            return None
        return self._array("predict", (4,), memory, tool, p1)

    def _numbers(self, memory: Any) -> Floats:
        if type(self.own).remembered is Estimator.remembered:
            return NOTHING
        return self._array("remembered", (-1,), memory)

    def _array(self, method: str, shape: tuple[int, ...], *given: Any) -> Floats:
        """What a method gives, as an array of this shape; -1 stands for any length."""
        value = self._of(method, *given)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise self._wrong(method, f"gave {one_line(repr(value))} instead of numbers") from error
        wanted = tuple(array.size if n < 0 else n for n in shape)
        if array.shape != wanted:
            raise self._wrong(method, f"gave numbers of shape {array.shape}, not {shape}")
        return array

    def _of(self, method: str, *given: Any) -> Any:
        try:
            return getattr(self.own, method)(*given)
        except Exception as error:  # whatever it is, the loop goes on to its fault
            raise self._wrong(method, f"raised {one_line(repr(error))}") from error

    def _wrong(self, method: str, what: str) -> UnusableEstimator:
        return UnusableEstimator(f"estimator {called(self.own)}: its {method} {what}")


@final
class Strict(Guard):
    """The same where nothing moves: what the estimator does wrong is raised."""

    def update(self, memory: Guarded, tool: Tool, sample: Sample) -> Guarded:
        return self._updated(memory, tool, sample)


def strict(estimator: Estimator) -> Estimator:
    """The estimator with its failures raised; ours as it is."""
    return Strict(estimator) if isinstance(learner(estimator), Guard) else estimator


def time_anew(estimator: Estimator) -> None:
    """Forget how long it has taken: what it took while it was warmed up delayed no motion."""
    if isinstance(estimator, Guard):
        estimator.slowest = 0


def examine(estimator: object, tool: Tool) -> None:
    """Try a user's estimator; UnusableEstimator where it is none, or answers wrongly."""
    if not isinstance(estimator, Estimator):
        raise UnusableEstimator(
            f"estimator {called(estimator)}: it must derive from rcmservo.Estimator"
        )
    own = learner(estimator)
    if not isinstance(own, Guard):
        return
    memory = own.init()
    if memory.failure:
        raise UnusableEstimator(memory.failure)
    for sample in _made_up(tool):
        memory, twin = (own.update(memory, tool, sample) for _ in range(2))
        _judge(memory, twin, called(estimator))


def _judge(memory: Guarded, twin: Guarded, name: str) -> None:
    if memory.failure:
        raise UnusableEstimator(memory.failure)
    if memory.J_hat.tobytes() != twin.J_hat.tobytes():
        raise UnusableEstimator(
            f"estimator {name}: its update must be pure, but gave two answers to one question"
        )


def _made_up(tool: Tool) -> Iterator[Sample]:
    """A tool that winds its way before a camera, 100 mm from the RCM."""
    o_c = np.array([320.0, 100.0])
    for i in range(TRIES):
        p1 = np.array([10.0 * np.sin(0.3 * i), 10.0 * np.cos(0.2 * i), 100.0 + 0.5 * i])
        both = np.stack([p1, tool.second_marker(p1)])
        depth = 1.0 + 0.002 * both[:, 1]
        points = o_c + 3.0 * both[:, [0, 2]] / depth[:, None]
        yield Sample(p1, points, o_c, 1.0 / 60.0 if i else 0.0, 10.0 / depth)
