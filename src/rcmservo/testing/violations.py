"""Violations of a part's contract, and calls that report them."""

from collections import defaultdict
from collections.abc import Generator
from contextlib import contextmanager
from statistics import median
from typing import Any, NoReturn, final

from rcmservo.errors import RcmServoError, shorten_to_line
from rcmservo.interfaces import Clock
from rcmservo.loop.device_checks import check_first_value

MAX_CALL_NS = 1_000_000
"""Longest time in ns that a call in every tick may take."""

TIME_UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "µs": 1_000}
"""Units of time that are mistaken for ns, in ns."""


class ContractViolation(RcmServoError):
    """Rule of its contract that a part breaks, in one sentence that names the method."""


@contextmanager
def report_violations() -> Generator[None]:
    """Raise errors of the servo's and the plant's own checks as `ContractViolation`."""
    try:
        yield
    except ContractViolation:
        raise
    except RcmServoError as error:
        raise ContractViolation(str(error)) from error


@final
class WatchedPart:
    """Part whose calls are timed and whose exceptions are violations.

    Parameters
    ----------
    part : object
        Part of the user.
    clock : Clock or None
        Clock that times the calls; None for a part whose calls need not be short.
    """

    def __init__(self, part: object, clock: Clock | None = None) -> None:
        self.part, self.clock = part, clock
        self._durations_ns: dict[str, list[int]] = defaultdict(list)

    def fail(self, method: str, finding: str) -> NoReturn:
        """Raise the violation of a method; the finding is a clause that follows its name."""
        raise ContractViolation(f"{type(self.part).__name__}.{method}() {finding}")

    def require(self, condition: bool, method: str, finding: str) -> None:
        """Raise the violation unless the condition holds; write it so that NaN fails it."""
        if not condition:
            self.fail(method, finding)

    def call(self, method: str, *arguments: object) -> Any:
        """Return the result of a method; an exception of any kind is a violation."""
        function = getattr(self.part, method, None)
        if not callable(function):
            self.fail(method, "is missing")
        began = self._read_clock()
        try:
            value = function(*arguments)
        except Exception as error:
            finding = f"raised {shorten_to_line(repr(error))}"
            raise ContractViolation(f"{type(self.part).__name__}.{method}() {finding}") from error
        self._durations_ns[method].append(self._read_clock() - began)
        return value

    def call_checked(self, method: str, *arguments: object) -> Any:
        """Return the result of a method of a device, of the type and shape of its protocol."""
        value = self.call(method, *arguments)
        self.require_type(method, value)
        return value

    def require_type(self, method: str, value: object) -> None:
        """Raise the violation if a method of a device returned a value of another type or shape."""
        with report_violations():
            check_first_value(self.part, method, value)

    def require_short(self, method: str) -> None:
        """Raise the violation if a method usually blocks: a single late call is no fault."""
        duration_ns = median(self._durations_ns[method])
        finding = f"took {duration_ns * 1e-6:.1f} ms; it must return within 1 ms, without waiting"
        self.require(duration_ns <= MAX_CALL_NS, method, finding)

    def _read_clock(self) -> int:
        return 0 if self.clock is None else self.clock.now()


def describe_time_defect(time: int, now: int, max_age_ns: int) -> str:
    """Return the reason why a time is not one of the last `max_age_ns`; empty if it is."""
    if 0 <= now - time <= max_age_ns:
        return ""
    shown = f"{time} while the plant's clock shows {now} ns"
    for unit, ns in TIME_UNITS_NS.items():
        if time > 0 and abs(time * ns - now) <= max(ns, max_age_ns):
            return f"{shown}: it is in {unit}, expected ns"
    difference_s = (now - time) * 1e-9
    if 0.0 <= difference_s <= 60.0:
        return f"{shown}: it is {difference_s * 1e3:.4g} ms old"
    return f"{shown}: it is not a time of this clock, from which it differs by {difference_s:.4g} s"
