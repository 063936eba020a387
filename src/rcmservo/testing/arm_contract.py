"""Contract of an arm: what it reports at rest, and how it obeys commands and their deadlines."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import final

import numpy as np

from rcmservo.geometry.kinematics import FULL_TURN_RAD, SPHERICAL, RcmStruct
from rcmservo.interfaces import Arm, ArmMeasurement, Clock, Command, Floats
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import ENABLE_POLL_NS, ENABLE_TIMEOUT_S
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.testing.clock_contract import check_clock
from rcmservo.testing.violations import WatchedPart, describe_time_defect

TRIAL_SPEED, TRIAL_SLEW = (0.05, 0.05, 5.0), (0.5, 0.5, 50.0)
"""Rates of the trial motions in rad/s, rad/s, mm/s, and their largest change per s.

An arm that takes mm/s for m/s is thus stopped after some cm.
"""

TRIAL_RATES = np.array(TRIAL_SPEED)

TRIAL_MOTION_S, REST_S = 0.4, 0.3
"""Times in s of one trial motion and of the rest after it."""

TRIAL_DISTANCE = TRIAL_MOTION_S * TRIAL_RATES
"""Length of a trial motion in rad, rad, mm."""

MAX_DISTANCE = 3.0 * TRIAL_DISTANCE
"""Distance in rad, rad, mm at which a trial motion ends early."""

REST_DISTANCE = 0.05 * TRIAL_DISTANCE
"""Largest motion in rad, rad, mm of an arm at rest."""

MIN_APPLIED = 1e-4
"""Smallest applied fraction of a trial motion from which a ratio is computed."""

MIN_RATIO, MAX_RATIO = 0.7, 1.3
"""Limits of measured divided by applied motion."""

WATCHDOG_ALLOWANCE_S = 0.2
"""Time in s after a deadline within which the arm must report its drive as off."""

OBSERVATION_S = 0.2
"""Time in s for which the arm's reports at rest are watched."""

UNLIMITED = RcmStruct(SPHERICAL, 0.0, (-1e9, -1e9, -1e9), (1e9, 1e9, 1e9))
"""Mechanism without joint limits: the operator puts the arm where the trial motions are free."""

JOINT_UNITS = "rad", "rad", "mm"
UNIT_RATIOS = (
    ((180.0 / np.pi, "degrees instead of rad"), (np.pi / 180.0, "rates taken as degrees/s")),
    ((180.0 / np.pi, "degrees instead of rad"), (np.pi / 180.0, "rates taken as degrees/s")),
    ((1e-3, "m instead of mm"), (1e3, "µm instead of mm, or rates taken as m/s")),
)
"""Ratios of measured to applied motion by which each joint's unit is recognised."""


def check_arm(arm: Arm, clock: Clock, *, may_move: bool = False) -> None:
    """Check an arm against its contract; nothing moves without `may_move`.

    At rest the check reads the arm for 0.2 s: type, unit and time of its reports, and whether it
    blocks. With `may_move` it also enables the drive and tests the motion, the watchdog, and
    commands that are expired or disable the drive.

    Parameters
    ----------
    arm : Arm
        Arm with its drive off.
    clock : Clock
        Clock of the plant that the arm will be used with.
    may_move : bool
        True if the arm may move: the caller's consent. **The arm then moves** for about 6 s. Each
        joint goes to and fro by 0.02 rad or 2 mm at 0.05 rad/s or 5 mm/s, and joint 3 moves at
        5 mm/s for less than a second more. An arm that violates its contract may move further: be
        ready to stop it. The check reads no joint limits, so put the arm where these motions are
        free. The drive is disabled at the end, whatever happens.

    Raises
    ------
    ContractViolation
        With the first violation in one sentence.

    Notes
    -----
    Calls are timed with `clock`. An arm in simulated time may thus compute as long as it needs.
    """
    check_clock(clock)
    probe = ArmProbe(arm, clock)
    _check_reports(probe)
    if not may_move:
        return
    probe.warm_up()
    for checks in ((_check_motion, _check_watchdog), (_check_expired,), (_check_disabling,)):
        with probe.enabled():
            for check in checks:
                check(probe)
    probe.part.require_short("apply")
    probe.part.require_short("measure")


@final
class ArmProbe:
    """Arm whose reports are checked at every call, with the commands that the check sends.

    Parameters
    ----------
    arm : Arm
        Arm of the user.
    clock : Clock
        Clock of the plant.
    """

    def __init__(self, arm: Arm, clock: Clock) -> None:
        self.part, self.clock = WatchedPart(arm, clock), clock
        self.gate = Gate(speed=TRIAL_SPEED, slew=TRIAL_SLEW)
        self.last, self.travel = self.gate.rest(), np.zeros(3)
        self._applied, self._applied_at = np.zeros(3), 0
        self._report: tuple[ArmMeasurement, Floats] | None = None

    def measure(self) -> ArmMeasurement:
        """Return the arm's report if it has the form that the contract states."""
        report: ArmMeasurement = self.part.call_checked("measure")
        finding = f"returned q = {report.q}, expected finite joints"
        self.part.require(bool(np.isfinite(report.q).all()), "measure", finding)
        if self._report is not None:
            previous, q = self._report
            finding = "overwrote the array q of its previous report, expected a new array"
            self.part.require(previous.q.tobytes() == q.tobytes(), "measure", finding)
            finding = f"returned the time {report.time} ns after {previous.time} ns: it goes back"
            self.part.require(report.time >= previous.time, "measure", finding)
        self._report = report, report.q.copy()
        return report

    def warm_up(self) -> None:
        """Compile the gate before the drive is enabled."""
        self.gate.admit(np.zeros(3), self.last, np.zeros(3), UNLIMITED, self.clock.now())

    @contextmanager
    def enabled(self) -> Generator[None]:
        """Enable the drive, and disable it at the end whatever happens."""
        try:
            self.part.call("enable")
            end = self.clock.now() + round(ENABLE_TIMEOUT_S * 1e9)
            while not self.measure().enabled:
                finding = "must report enabled = True within 2 s after enable()"
                self.part.require(self.clock.now() < end, "measure", finding)
                self.clock.wait_until(self.clock.now() + ENABLE_POLL_NS)
            yield
        except BaseException:
            with suppress(Exception):  # the first violation is the one to report
                self.part.call("apply", self.gate.stop(self.last, self.clock.now()))
            raise
        self.disable()

    def disable(self) -> None:
        """Send a command that disables the drive."""
        self.send(self.gate.stop(self.last, self.clock.now()))

    def send(self, command: Command) -> None:
        """Send a command and add the applied motion to `travel` (3,) in rad, rad, mm."""
        self.last, now, rates = command, self.clock.now(), command.rates.copy()
        self.travel += self._applied * (now - self._applied_at) * 1e-9
        self._applied, self._applied_at = np.zeros(3), now
        applied: Floats = self.part.call_checked("apply", command)
        finding = "changed command.rates in place, expected the command unchanged"
        self.part.require(command.rates.tobytes() == rates.tobytes(), "apply", finding)
        is_possible = bool((np.abs(applied) <= MAX_RATIO * TRIAL_RATES).all())
        finding = f"returned the rates {applied} for commands of at most {TRIAL_RATES}"
        self.part.require(is_possible, "apply", f"{finding} rad/s, rad/s, mm/s")
        self._applied = applied.copy()

    def drive(self, rates: Floats, duration: float, max_distance: Floats = MAX_DISTANCE) -> None:
        """Send rates (3,) for a `duration` in s; end early at the largest distance."""
        start = self.measure().q.copy()
        for _ in ticks(self.clock, 100.0, duration):
            q = self.measure().q
            if not (np.abs(q - start) <= max_distance).all():
                break
            self.send(self.gate.admit(rates, self.last, q, UNLIMITED, self.clock.now()).command)

    def wait(self, seconds: float) -> ArmMeasurement:
        """Return the report after a time without commands."""
        self.clock.wait_until(self.clock.now() + round(seconds * 1e9))
        return self.measure()

    def require_stopped(self, why: str) -> None:
        """Raise the violation unless the drive is off and the joints are at rest."""
        report = self.wait(WATCHDOG_ALLOWANCE_S)
        finding = f"reports the drive as on, 200 ms after {why}, expected it off"
        self.part.require(not report.enabled, "measure", finding)
        moved = np.abs(self.wait(OBSERVATION_S).q - report.q)
        finding = f"reports joints that still move by {moved}, 200 ms after {why}"
        self.part.require(bool((moved <= REST_DISTANCE).all()), "measure", finding)


def _check_reports(probe: ArmProbe) -> None:
    """Check the reports of an arm whose drive is off."""
    require = probe.part.require
    max_age_ns = round(Thresholds().arm_timeout * 1e9)
    for _ in ticks(probe.clock, 100.0, OBSERVATION_S):
        probe.measure()
    probe.part.require_short("measure")
    report, now = probe.measure(), probe.clock.now()
    defect = describe_time_defect(report.time, now, max_age_ns)
    require(not defect, "measure", f"returned the time {defect}")
    require(not report.enabled, "measure", "reports the drive as on before enable()")
    finding = f"returned q = {report.q}: joints 1 and 2 must be in rad, these look like degrees"
    require(bool((np.abs(report.q[:2]) <= FULL_TURN_RAD).all()), "measure", finding)


def _check_motion(probe: ArmProbe) -> None:
    """Check that each joint follows its rate, and no other joint moves."""
    for i in range(3):
        rates = np.where(np.arange(3) == i, TRIAL_RATES, 0.0)
        start, travel = probe.measure().q.copy(), probe.travel.copy()
        probe.drive(rates, TRIAL_MOTION_S)
        probe.drive(np.zeros(3), REST_S)
        _require_followed(probe, i, probe.measure().q - start, probe.travel - travel)
        probe.drive(-rates, TRIAL_MOTION_S)
        probe.drive(np.zeros(3), REST_S)


def _require_followed(probe: ArmProbe, i: int, moved: Floats, applied: Floats) -> None:
    """Raise the violation unless the measured motion (3,) of joint i is the applied one."""
    joint, unit = f"joint {i + 1}", JOINT_UNITS[i]
    finding = f"applied none of the rate that was commanded for {joint}"
    probe.part.require(abs(applied[i]) > MIN_APPLIED * TRIAL_DISTANCE[i], "apply", finding)
    others = [k for k in range(3) if k != i and not abs(moved[k]) <= 0.5 * TRIAL_DISTANCE[k]]
    finding = f"moved joint {[k + 1 for k in others]} by a rate that was commanded for {joint}"
    probe.part.require(not others, "apply", finding)
    ratio = moved[i] / applied[i]
    guess = next((f": {u}?" for r, u in UNIT_RATIOS[i] if 0.7 * r <= ratio <= 1.3 * r), "")
    guess = ": opposite direction" if ratio <= -MIN_RATIO else guess
    finding = f"reports that {joint} moved by {moved[i]:.3g} where apply() returned rates of"
    finding = f"{finding} {applied[i]:.3g} {unit} in all, {ratio:.3g} times as far{guess}"
    probe.part.require(MIN_RATIO <= ratio <= MAX_RATIO, "measure", finding)


def _check_watchdog(probe: ArmProbe) -> None:
    """Check that the arm stops by itself when commands no longer arrive."""
    probe.drive(np.array([0.0, 0.0, TRIAL_RATES[2]]), 0.2)
    probe.clock.wait_until(probe.last.deadline)
    probe.require_stopped("the deadline of the last command")


def _check_expired(probe: ArmProbe) -> None:
    """Check that commands whose deadline has passed neither move the arm nor feed its watchdog."""
    probe.drive(np.zeros(3), 0.05)
    start = probe.measure().q.copy()
    for _ in ticks(probe.clock, 100.0, OBSERVATION_S):
        now = probe.clock.now()
        rates = np.array([0.0, 0.0, -TRIAL_RATES[2]])
        command = probe.gate.admit(rates, probe.last, start, UNLIMITED, now).command
        probe.send(replace(command, deadline=now - 1))
    moved = np.abs(probe.measure().q - start)
    finding = f"obeyed commands whose deadline had passed: the joints moved by {moved}"
    probe.part.require(bool((moved <= 2.0 * REST_DISTANCE).all()), "apply", finding)
    probe.require_stopped("the last command that had not expired")


def _check_disabling(probe: ArmProbe) -> None:
    """Check that commands that are not enabled switch the drive off, though they are in time."""
    probe.drive(np.array([0.0, 0.0, -TRIAL_RATES[2]]), 0.2)
    for _ in ticks(probe.clock, 100.0, OBSERVATION_S):
        probe.disable()
    finding = "left the drive on after commands with enabled = False"
    probe.part.require(not probe.measure().enabled, "apply", finding)
    probe.require_stopped("a command with enabled = False")
