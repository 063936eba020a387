"""Sequence of steps of `rig check`, from the first frames to corrections of the rig file.

The check observes the tool at rest, moves each joint slightly, fits hypotheses about one mistake in
the rig file to the observations, and asks the operator where the image leaves several possible. If
the rig file is right, it reports the backlash of each joint. It uses only the readings of arm and
camera and the operator's answers. The drive is off when it ends, also after an error or an
interrupt.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.backlash import Backlash
from rcmservo.bringup.corrections import (
    describe_hypothesis,
    describe_undetectable_error,
    list_corrections,
)
from rcmservo.bringup.findings import CheckAborted, Finding
from rcmservo.bringup.hypotheses import Hypothesis, generate_equivalents
from rcmservo.bringup.motion import REST_TIME, Mover
from rcmservo.bringup.motion_escalation import MotionEscalation
from rcmservo.bringup.observations import MotionTrace, StillView
from rcmservo.bringup.operator_questions import ask_operator
from rcmservo.bringup.prompts import ask_choice, require_yes
from rcmservo.bringup.timing import (
    Cadence,
    CameraLatency,
    compare_drive_lag,
    compare_latency,
    follow_motor,
    identify_drive_lag,
    identify_latency,
    measure_cadence,
)
from rcmservo.errors import Stopped
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import OperatorTerminal, SuspendsCommunication
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds

LATENCY_MOTIONS = 12
"""Motions in alternating directions that identify the latency of the camera and the backlash of the
joint together. Both delay the image, so that half as many would give 1.4 times the deviation."""
MIN_FRAME_RATE = 10.0
"""Lowest frame rate (1/s) of the camera that passes."""
MIN_VISIBLE_FRACTION = 0.9
"""Smallest fraction of the frames with both markers that passes."""
LIMIT_MARGIN_MM = 3.0
"""Motion (mm) of marker 2 that must remain between each joint and its limits."""


@dataclass
class CheckReport:
    """Findings and measurements of a check.

    Parameters
    ----------
    findings : list[Finding]
        Mismatches between rig file, devices and image.
    q : Floats or None
        Joints (3,) in rad, rad, mm at the start of the check.
    arm : Cadence or None
        Rate and jitter of the arm's answers.
    camera : Cadence or None
        Rate and jitter of the camera's exposures.
    rest : StillView or None
        Joints and markers at the start of the check.
    latency : CameraLatency or None
        Identified latency of the camera; None if it was not measured.
    lag : float
        Lag (s) of the drives; 0 if it was not measured.
    backlash : list[Backlash]
        Backlash of each joint; empty unless the other steps confirm the rig file.
    undecided : list[str]
        Hypotheses that the image does not distinguish, in words; the operator decided.
    unclear : list[str]
        Errors of the rig file that the motions could not reveal, in words.
    done : bool
        True if the check completed all steps.
    """

    findings: list[Finding] = field(default_factory=list[Finding])
    q: Floats | None = None
    arm: Cadence | None = None
    camera: Cadence | None = None
    rest: StillView | None = None
    latency: CameraLatency | None = None
    lag: float = 0.0
    backlash: list[Backlash] = field(default_factory=list[Backlash])
    undecided: list[str] = field(default_factory=list[str])
    unclear: list[str] = field(default_factory=list[str])
    done: bool = False

    @property
    def ok(self) -> bool:
        """True if the check completed and confirms the rig file."""
        return self.done and not self.findings


def check(
    mover: Mover,
    operator: OperatorTerminal,
    robot: Robot,
    thresholds: Thresholds,
    latency: float | None,
    has_latency_key: bool = True,
) -> CheckReport:
    """Observe the tool at rest, move each joint slightly, and compare with the rig file.

    Parameters
    ----------
    mover
        Arm and camera.
    operator
        Operator who answers questions and agrees to each motion.
    robot
        Arm as the rig file describes it.
    thresholds
        Thresholds of the rig file, with its drive lag.
    latency
        Latency (s) of the camera in the rig file. None if the file has none: the exposure time of
        a frame is then its arrival time.
    has_latency_key
        False for a user-defined camera that has no key `latency` in the rig file, because it
        determines the exposure times itself.

    Returns
    -------
    CheckReport
        Findings and measurements; incomplete if the check aborted.
    """
    return _Check(mover, operator, robot, thresholds, latency, has_latency_key).run()


def warm_up(robot: Robot, gate: Gate) -> None:
    """Compile all kernels before the arm is connected, because compilation would delay commands."""
    zeros, rcm = np.zeros(3), robot.mechanism.to_struct()
    gate.stop(gate.admit(zeros, gate.rest(), zeros, rcm, 1).command, 2)
    identify_drive_lag(MotionTrace(answers=[(k, zeros, zeros) for k in range(3)]), np.ones(3))
    q = np.array(robot.mechanism.limits.arrays).mean(axis=0)
    robot.compute_joint_per_mm(q)
    follow_motor(zeros, 0.0)
    Hypothesis().compute_markers(robot, q[None])


@dataclass(eq=False)
class _Check:
    """State and steps of one check, with the parameters of `check`."""

    mover: Mover
    operator: OperatorTerminal
    robot: Robot
    thresholds: Thresholds
    latency: float | None
    has_latency_key: bool
    report: CheckReport = field(default_factory=CheckReport)

    def run(self) -> CheckReport:
        """Run all steps; switch the drive off at the end, also after an error."""
        findings = self.report.findings
        try:
            self._run_steps()
            self.report.done = True
        except CheckAborted as aborted:
            findings.append(aborted.finding)
        except Stopped as stop:
            expected = "agreement to every motion until the check is complete"
            findings.append(Finding("the check was stopped", "operator", str(stop), expected))
        finally:
            self.mover.switch_off()
        return self.report

    def _run_steps(self) -> None:
        if not self.mover.arm.is_homed():
            raise CheckAborted(
                "the arm does not know its joint positions",
                "arm",
                "not homed since its controller was reset",
                "homed, or its joint positions defined at a mark",
            )
        rest, report = self.mover.observe_at_rest(), self.report
        answers, frames = self.mover.trace.answers, self.mover.trace.frames
        report.rest, report.q = rest, rest.q
        report.arm = measure_cadence([time for time, _, _ in answers])
        report.camera = measure_cadence([exposure for exposure, _, _ in frames])
        self._require_room(rest.q)
        report.findings += compare_picture(rest, report.camera)
        self.operator.notify(
            "The check asks before each motion. Motions are slow and at most a few mm long; the "
            "drive is on only during a motion. Keep a hand on the emergency stop."
        )
        question = "May the drive be switched on for these motions?"
        if ask_choice(self.operator, question, ("enable", "no")) == "no":
            raise Stopped("the operator did not allow the drive to be switched on")
        escalation = MotionEscalation(self.mover, self.operator, self.robot, rest)
        fits = escalation.run(lambda joint: self._require_stop(escalation, joint))
        self._measure_times(escalation)
        self._add_corrections(escalation, fits)
        if not report.findings:
            report.backlash = escalation.measure_backlash()

    def _require_room(self, q: Floats) -> None:
        """Abort if a joint is within `LIMIT_MARGIN_MM` of a limit, or beyond it."""
        lower, upper = self.robot.mechanism.limits.arrays
        margin = LIMIT_MARGIN_MM * self.robot.compute_joint_per_mm(q)
        is_too_low = ~(q >= lower + margin)
        is_at_limit = is_too_low | ~(q <= upper - margin)
        if is_at_limit.any():
            joint = int(np.argmax(is_at_limit))
            raise CheckAborted(
                f"{self.robot.describe_joint(joint)} is at or beyond a limit",
                f"mechanism.{'lower' if is_too_low[joint] else 'upper'}[{joint}]",
                f"{q[joint]:.4g}",
                f"between {lower[joint]:.4g} and {upper[joint]:.4g} with a margin of "
                f"{LIMIT_MARGIN_MM:g} mm: move the tool by hand, or rehome the arm",
            )

    def _require_stop(self, escalation: MotionEscalation, joint: int) -> None:
        """Abort if a rate-controlled arm keeps moving after its commands cease."""
        arm = self.mover.arm
        if not (isinstance(arm, SuspendsCommunication) and arm.is_rate_controlled):
            return
        motion = float(escalation.motions[joint])
        question = escalation.format_question(joint, motion, ", interrupt the commands midway")
        require_yes(self.operator, question)
        if not self.mover.stops_without_commands(joint, motion):
            what = "the arm keeps moving without commands"
            found = f"joint {joint + 1} still moved {REST_TIME:g} s after the last command"
            where, way, line = "arm.jv", "command positions instead of rates", "jv = false"
            if not self.robot.wiring.key:
                where, way, line = "arm", "let the arm itself stop after the deadline", ""
            expected = f"at rest without commands: {way}"
            raise CheckAborted(what, where, found, expected, line)

    def _measure_times(self, escalation: MotionEscalation) -> None:
        """Identify the latency of the camera and the lag of the drives."""
        report, joint = self.report, int(np.argmax(escalation.displacement))
        motion = escalation.choose_next_motion(joint)
        repetition = f" in alternating directions, {LATENCY_MOTIONS} times"
        require_yes(self.operator, escalation.format_question(joint, motion, repetition))
        self.mover.visit(joint, LATENCY_MOTIONS // 2 * (motion, -motion))
        trace = self.mover.trace
        report.latency = identify_latency(trace, joint)
        report.lag = identify_drive_lag(trace, np.array(self.mover.gate.speed))
        report.findings += compare_latency(report.latency, self.latency, self.has_latency_key)
        report.findings += compare_drive_lag(report.lag, self.thresholds.drive_lag)

    def _add_corrections(self, escalation: MotionEscalation, fits: list[Hypothesis]) -> None:
        """Add the corrections of the hypotheses that agree with the operator's answers."""
        report, robot, operator = self.report, self.robot, self.operator
        views = escalation.collect_views()
        if not fits[0].explains(views):
            ratio = np.sqrt(fits[0].misfit / views.points.size)
            report.findings.append(
                Finding(
                    "no single error of the rig file explains the image",
                    "arm, mechanism, tool, markers",
                    f"residuals of the best hypothesis {ratio:.1f} times the noise",
                    "at most one error: check all of [arm], [mechanism], [tool] and [markers]",
                )
            )
            return

        def show_motion(joint: int) -> None:
            motion = escalation.choose_next_motion(joint)
            require_yes(operator, escalation.format_question(joint, motion))
            self.mover.visit(joint, (motion,), escalation.compute_bound(joint, motion))

        uncorrected = [fit for fit in fits if fit.number is None]
        unclear = [fit for plain in uncorrected for fit in escalation.find_unclear(plain)]
        report.unclear = sorted({describe_undetectable_error(fit, robot) for fit in unclear})
        for setting in report.unclear:
            operator.notify(f"{setting}. Measure it by hand.")
        possible = [candidate for fit in fits for candidate in generate_equivalents(fit)]
        report.undecided = sorted({describe_hypothesis(candidate, robot) for candidate in possible})
        choose_motion = escalation.choose_next_motion
        remaining = ask_operator(
            fits, robot, escalation.start, operator, show_motion, choose_motion
        )
        for number, hypothesis in enumerate(remaining, start=1):
            count = len(remaining)
            prefix = f"possibility {number} of {count}: " if count > 1 else ""
            findings = list_corrections(hypothesis, robot)
            report.findings += [replace(found, what=prefix + found.what) for found in findings]


def compare_picture(rest: StillView, camera: Cadence) -> list[Finding]:
    """Return a finding for a low frame rate and one for markers missing in many frames."""
    findings: list[Finding] = []
    if not camera.rate >= MIN_FRAME_RATE:
        found, expected = f"{camera.rate:.3g} frames/s", f"at least {MIN_FRAME_RATE:g} frames/s"
        findings.append(Finding("the frame rate is low", "camera", found, expected))
    visible_fraction = rest.frames / (rest.frames + rest.missed)
    if not visible_fraction >= MIN_VISIBLE_FRACTION:
        found = f"both in {100 * visible_fraction:.0f} % of the frames"
        advice = "check light, focus, and the colours in [markers]"
        expected = f"at least {100 * MIN_VISIBLE_FRACTION:.0f} %: {advice}"
        findings.append(Finding("the markers are not always visible", "markers", found, expected))
    return findings
