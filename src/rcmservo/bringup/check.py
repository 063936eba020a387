"""Check of a laboratory, from the first look to the corrections of its rig file.

It knows no more than what arm and camera report and an operator answers. It ends with the drive
off, however it ends.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.corrections import corrections, in_words, undetectable_error
from rcmservo.bringup.findings import CheckAborted, Finding
from rcmservo.bringup.hypotheses import Hypothesis, equivalents
from rcmservo.bringup.motion import REST_TIME, Mover
from rcmservo.bringup.motion_escalation import MotionEscalation
from rcmservo.bringup.observations import MotionTrace, StillView
from rcmservo.bringup.operator_questions import ask_operator
from rcmservo.bringup.prompts import ask_choice, require_yes
from rcmservo.bringup.timing import (
    Cadence,
    CameraLatency,
    cadence,
    drive_lag,
    identify_latency,
    lag_findings,
    latency_findings,
)
from rcmservo.errors import Stopped
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import OperatorTerminal, SuspendsCommunication
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds

SWINGS = 6
"""Motions to and fro that identify the latency."""
MIN_FRAME_RATE = 10.0
"""Frames per s."""
MIN_FOUND = 0.9
"""Fraction of the frames that must show both markers."""
LIMIT_MARGIN_MM = 3.0
"""Distance of marker 2 that the joints must be from their limits."""


@dataclass
class CheckReport:
    """Findings and measurements of a check.

    Parameters
    ----------
    findings : list[Finding]
        All mismatches.
    q : Floats or None
        The joints (3,) at first.
    arm : Cadence or None
        Answers of the arm.
    camera : Cadence or None
        Exposures of the camera.
    rest : StillView or None
        Joints and markers at first.
    latency : CameraLatency or None
        Latency of the camera.
    lag : float
        Lag (s) of the drives; 0 if it was not measured.
    undecided : list[str]
        Hypotheses that only the operator distinguished, in words.
    unclear : list[str]
        Errors that the picture does not show, in words.
    done : bool
        True if the check came to its end.
    """

    findings: list[Finding] = field(default_factory=list[Finding])
    q: Floats | None = None
    arm: Cadence | None = None
    camera: Cadence | None = None
    rest: StillView | None = None
    latency: CameraLatency | None = None
    lag: float = 0.0
    undecided: list[str] = field(default_factory=list[str])
    unclear: list[str] = field(default_factory=list[str])
    done: bool = False

    @property
    def ok(self) -> bool:
        """True if all is as the rig file says."""
        return self.done and not self.findings


def check(
    mover: Mover,
    person: OperatorTerminal,
    robot: Robot,
    thresholds: Thresholds,
    latency: float | None,
) -> CheckReport:
    """Look, move a little, and decide.

    `latency` (s) is that of the camera in the rig file; None if it was never measured, with frames
    dated as if exposed when they arrive.
    """
    return _Check(mover, person, robot, thresholds, latency).run()


def warm_up(robot: Robot, gate: Gate) -> None:
    """Compile all kernels before an arm is connected, which must not wait for them."""
    command = gate.admit(np.zeros(3), gate.rest(), np.zeros(3), robot.mechanism.rcm(), 1).command
    gate.stop(command, 2)
    drive_lag(MotionTrace(answers=[(k, np.zeros(3), np.zeros(3)) for k in range(3)]), np.ones(3))
    q = np.array(robot.mechanism.limits.arrays).mean(axis=0)
    robot.joint_per_mm(q)
    Hypothesis().markers(robot, q[None])


@dataclass(eq=False)
class _Check:
    """The steps of a check."""

    mover: Mover
    person: OperatorTerminal
    robot: Robot
    thresholds: Thresholds
    latency: float | None
    report: CheckReport = field(default_factory=CheckReport)

    def run(self) -> CheckReport:
        """Take all steps; whatever happens, the drive is off in the end."""
        findings = self.report.findings
        try:
            self._run()
            self.report.done = True
        except CheckAborted as aborted:
            findings.append(aborted.finding)
        except Stopped as stopped:
            expected = "to its end, with every motion agreed to"
            findings.append(Finding("the check was ended", "person", str(stopped), expected))
        finally:
            self.mover.off()
        return self.report

    def _run(self) -> None:
        if not self.mover.arm.homed():
            raise CheckAborted(
                "the arm does not know where it stands",
                "arm",
                "nobody has said so since it was reset",
                "homed, or its position defined at a mark",
            )
        rest = self.mover.look()
        self._describe(rest)
        self._require_room(rest.q)
        self._require_picture(rest)
        self.person.tell(
            "Each motion is asked for. It is slow, a few mm at most, and the drive is on only "
            "meanwhile. Have a hand on the emergency stop."
        )
        question = "May the drive be switched on for that?"
        if ask_choice(self.person, question, ("enable", "no")) == "no":
            raise Stopped("the drive may not be switched on")
        escalation = MotionEscalation(self.mover, self.person, self.robot, rest)
        fits = escalation.run(lambda joint: self._require_stop(escalation, joint))
        self._measure_times(escalation)
        self._decide(escalation, fits)

    def _describe(self, rest: StillView) -> None:
        report, trace = self.report, self.mover.trace
        report.rest, report.q = rest, rest.q
        report.arm = cadence([time for time, _, _ in trace.answers])
        report.camera = cadence([exposure for exposure, _, _ in trace.frames])

    def _require_room(self, q: Floats) -> None:
        """Abort if a joint is at a limit."""
        lower, upper = self.robot.mechanism.limits.arrays
        margin = LIMIT_MARGIN_MM * self.robot.joint_per_mm(q)
        is_low = ~(q >= lower + margin)
        is_near = is_low | ~(q <= upper - margin)
        if is_near.any():
            joint = int(np.argmax(is_near))
            raise CheckAborted(
                f"{self.robot.name(joint)} is at a limit, or beyond it",
                f"mechanism.{'lower' if is_low[joint] else 'upper'}[{joint}]",
                f"{q[joint]:.4g}",
                f"{lower[joint]:.4g} to {upper[joint]:.4g}, with {LIMIT_MARGIN_MM:g} mm of room: "
                "bring the tool there by hand, or home the arm again",
            )

    def _require_picture(self, rest: StillView) -> None:
        """Report a camera that is slow or does not show the markers."""
        findings, camera = self.report.findings, self.report.camera
        if camera is None or not camera.rate >= MIN_FRAME_RATE:
            rate = "none" if camera is None else f"{camera.rate:.3g} frames/s"
            expected = f"at least {MIN_FRAME_RATE:g} frames/s"
            findings.append(Finding("the frame rate is low", "camera", rate, expected))
        found = rest.frames / (rest.frames + rest.missed)
        if not found >= MIN_FOUND:
            what, fraction = "the markers are not always seen", f"{100 * found:.0f} %"
            expected = f"{100 * MIN_FOUND:.0f} %: light, focus, and the colours in [markers]"
            findings.append(Finding(what, "markers", f"both in {fraction} of the frames", expected))

    def _require_stop(self, escalation: MotionEscalation, joint: int) -> None:
        """Abort unless an arm that takes rates comes to rest by itself once nothing is sent."""
        if not (isinstance(self.mover.arm, SuspendsCommunication) and self.mover.arm.by_speeds):
            return
        motion = float(escalation.motions[joint])
        question = escalation.question(joint, motion, ", and be left alone on the way")
        require_yes(self.person, question)
        if not self.mover.stops_by_itself(joint, motion):
            raise CheckAborted(
                "the arm goes on when nothing is sent",
                "arm.jv",
                f"joint {joint + 1} still moved when nothing had been sent for {REST_TIME:g} s",
                "at rest by itself: send it positions",
                "jv = false",
            )

    def _measure_times(self, escalation: MotionEscalation) -> None:
        """Identify the latency of the camera and the lag of the drives."""
        report, joint = self.report, int(np.argmax(escalation.shown))
        motion = escalation.next_motion(joint)
        question = escalation.question(joint, motion, f" to and fro, {SWINGS} times")
        require_yes(self.person, question)
        self.mover.visit(joint, SWINGS // 2 * (motion, -motion))
        trace = self.mover.trace
        report.latency = identify_latency(trace, joint)
        report.lag = drive_lag(trace, np.array(self.mover.gate.speed))
        report.findings += latency_findings(report.latency, self.latency)
        report.findings += lag_findings(report.lag, self.thresholds.drive_lag)

    def _decide(self, escalation: MotionEscalation, fits: list[Hypothesis]) -> None:
        """Report the corrections of the hypotheses that remain after the operator was asked."""
        report, robot, person = self.report, self.robot, self.person
        views = escalation.marker_views()
        if not fits[0].explains(views):
            ratio = np.sqrt(fits[0].misfit / views.points.size)
            report.findings.append(
                Finding(
                    "no single mistake explains the picture",
                    "arm, mechanism, tool, markers",
                    f"the residuals of the best one are {ratio:.1f} times the noise",
                    "one mistake at most: look at all of [arm], [mechanism], [tool] and [markers]",
                )
            )
            return

        def show(joint: int) -> None:
            motion = escalation.next_motion(joint)
            require_yes(person, escalation.question(joint, motion))
            self.mover.visit(joint, (motion,), escalation.bound(joint, motion))

        plain = [fit for fit in fits if fit.number is None]
        unclear = [one for fit in plain for one in escalation.unclear(fit)]
        report.unclear = sorted({undetectable_error(one, robot) for one in unclear})
        for words in report.unclear:
            person.tell(f"{words}: measure it by hand.")
        named = {other for fit in fits for other in equivalents(fit)}
        report.undecided = sorted({in_words(one, robot) for one in named})
        motion = escalation.next_motion
        left = ask_operator(fits, robot, escalation.start, person, show, motion)
        for number, hypothesis in enumerate(left, start=1):
            prefix = f"possibility {number} of {len(left)}: " if len(left) > 1 else ""
            found = corrections(hypothesis, robot)
            report.findings += [replace(one, what=prefix + one.what) for one in found]
