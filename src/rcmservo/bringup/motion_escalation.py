"""Motions of growing size of all joints, until the image identifies the error of the rig file.

The first motions are so small that no common error of a rig file makes them dangerous. A motion is
doubled only after the operator agrees, and only while the travel of marker 2 stays small under
every hypothesis that remains.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.hypotheses import Hypothesis, fit_all, most_likely
from rcmservo.bringup.identification import MarkerViews
from rcmservo.bringup.motion import Mover
from rcmservo.bringup.observations import PixelBound, StillView
from rcmservo.bringup.prompts import require_yes
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import OperatorTerminal

FIRST_MM, FIRST_COUNTS = 0.06, 50.0
"""First motion: travel (mm) of marker 2 by the rig file, and upper bound in encoder counts. The
bound keeps the motion small if the file has a thousand times too many counts per mm."""
MAX_TRAVEL_MM = 1.5
"""Largest travel of marker 2 under any remaining hypothesis."""
BLIND_MM, BLIND_RATIO = 0.4, 3.0
"""Travel (mm) up to which motions double before hypotheses are fitted, and the largest ratio of the
observed to the predicted travel for that."""
ABORT_RATIO, ABORT_MM = 4.0, 0.5
"""Bound on the observed travel beyond which the joint returns: this multiple of the predicted
travel, plus this margin (mm)."""
NOISE_DEVIATIONS = 5.0
"""Standard deviations of the noise up to which a displacement in the image is not a motion."""
MIN_MOTION_STEPS = 20.0
"""Smallest motion (counts) that suffices to test whether the arm stops without commands."""
MAX_LOG_FACTOR, SIZE_DEVIATIONS = 8.0, 2.0
"""Upper bound on the logarithm of a factor on a motion, and standard deviations that are added to a
fitted one."""
MIN_GROWTH = 1.15
"""Smallest ratio of the next motion to the present one that makes a repetition worthwhile."""
MIN_NOISE_PX, MAX_NOISE_PX = 0.03, 0.15
"""Bounds on the noise of a mean over frames. Within them, the residuals of the best hypothesis
count as errors of the tracker, for example from image compression."""
MAX_UNDETECTABLE = 0.15, 0.15, 0.15, 5.0, 0.05
"""Largest undetected errors (units of `CORRECTION_PRIOR`) that the report does not mention."""


class MotionEscalation:
    """Sequence of motions of growing size, with their observations and fitted hypotheses.

    Parameters
    ----------
    mover : Mover
        Arm and camera.
    operator : OperatorTerminal
        Operator who agrees to each motion.
    robot : Robot
        Arm as the rig file describes it.
    rest : StillView
        Joints and markers before the first motion.
    """

    def __init__(
        self, mover: Mover, operator: OperatorTerminal, robot: Robot, rest: StillView
    ) -> None:
        self.mover, self.operator, self.robot = mover, operator, robot
        self.views = [rest]
        self.fits: list[Hypothesis] = []
        """One fitted hypothesis of each class, by increasing misfit."""
        self._per_mm = robot.joint_per_mm(rest.q)
        self.motions = np.minimum(FIRST_MM * self._per_mm, FIRST_COUNTS * robot.wiring.steps)
        """Last motion (3,) of each joint in either direction in rad, rad, mm."""
        self.displacement = np.zeros(3)
        """Largest displacement (3,) of a marker in px during the last motion of each joint."""
        self._displaced_by = self.motions.copy()
        """Motion (3,) of each joint to which `displacement` belongs."""
        self._noise = MIN_NOISE_PX

    @property
    def start(self) -> Floats:
        """Joints (3,) at the start of the check."""
        return self.views[0].q

    def run(self, first_moved: Callable[[int], None]) -> list[Hypothesis]:
        """Move until one hypothesis remains or the next motion would be too large.

        `first_moved` is called once, with the first joint that moves visibly in the image and by
        `MIN_MOTION_STEPS` counts. Returns the most likely hypotheses.
        """
        active, is_still = [0, 1, 2], True
        while active:
            for joint in active:
                self._move(joint)
                if is_still and self._has_moved(joint):
                    first_moved(joint)
                    is_still = False
            larger = self._blindly_doubled()
            if not larger.any():
                self._fit()
                if self._is_decided():
                    break
                larger = np.array([self._worth_growth(joint) for joint in range(3)])
            active = [joint for joint in range(3) if larger[joint] > self.motions[joint]]
            self.motions = np.where(larger > 0.0, larger, self.motions)
        if is_still:
            first_moved(int(np.argmax(self.displacement)))
        return most_likely(self.fits)

    def marker_views(self) -> MarkerViews:
        """Return all views, with the noise of each."""
        q, points = np.stack([v.q for v in self.views]), np.stack([v.points for v in self.views])
        noise = np.array([max(view.mean_noise, self._noise) for view in self.views])
        return MarkerViews(q, points, noise, self.mover.size)

    def question(self, joint: int, motion: float, words: str = "") -> str:
        """Return the question to the operator whether a motion (rad or mm) is allowed."""
        size = f"{abs(motion * self.robot.wiring.counts[joint]):.0f} counts"
        if self.robot.wiring.has_signs_only:
            size = f"{motion:.3g} mm" if joint == 2 else f"{np.degrees(motion):.3g} deg"
        return f"Move {self.robot.name(joint)} by at most {size}{words}, and return?"

    def bound(self, joint: int, motion: float) -> PixelBound:
        """Return the bound on the markers in the image for a motion (rad or mm) of a joint."""
        predicted = motion / self._per_mm[joint] / self._mm_per_px()
        predicted = max(predicted, self.displacement[joint] * motion / self._displaced_by[joint])
        rest = self.views[0]
        margin = ABORT_MM / self._mm_per_px() + 2.0 * NOISE_DEVIATIONS * rest.noise
        return PixelBound(rest.points, ABORT_RATIO * predicted + margin)

    def next_motion(self, joint: int) -> float:
        """Return the next motion (rad or mm): twice the last one, or less.

        It is less if marker 2 would otherwise travel more than `MAX_TRAVEL_MM` under a remaining
        hypothesis.
        """
        motion = float(self.motions[joint])
        left = [fit for fit in self.fits if fit.is_close(self.fits[0])]
        travel = max(self._largest_travel(one, joint, motion) for one in left)
        return motion * min(2.0, MAX_TRAVEL_MM / travel)

    def unclear(self, plain: Hypothesis) -> list[Hypothesis]:
        """Return fits that correct a number of `plain` and allow a large undetected error of it.

        An error is large if it exceeds `MAX_UNDETECTABLE`.
        """
        return [
            fit
            for fit in self.fits
            if fit.number is not None
            and replace(fit, number=None, size=0.0) == plain
            and fit.undetectable > MAX_UNDETECTABLE[fit.number]
        ]

    def _move(self, joint: int) -> None:
        motion = float(self.motions[joint])
        require_yes(self.operator, self.question(joint, motion, " in either direction"))
        new = self.mover.visit(joint, (motion, -motion), self.bound(joint, motion))
        moved = [np.linalg.norm(v.points - self.views[0].points, axis=1).max() for v in new[:2]]
        self.displacement[joint], self._displaced_by[joint] = max(moved), motion
        self.views += new

    def _has_moved(self, joint: int) -> bool:
        """Return whether image and encoder both confirm a motion."""
        visible = self.displacement[joint] > NOISE_DEVIATIONS * self.views[0].mean_noise
        steps = self.motions[joint] / self.robot.wiring.steps[joint]
        return bool(visible and steps >= MIN_MOTION_STEPS)

    def _fit(self) -> None:
        """Fit all hypotheses; raise the noise to the residuals of the best one and fit again."""
        views = self.marker_views()
        self.fits = fit_all(self.robot, views)
        ratio = float(np.sqrt(self.fits[0].misfit / views.points.size))
        if ratio > 1.0 and self._noise < MAX_NOISE_PX:
            self._noise = min(self._noise * ratio, MAX_NOISE_PX)
            self.fits = fit_all(self.robot, self.marker_views())

    def _is_decided(self) -> bool:
        """Return whether one hypothesis remains and no other number may have a large error."""
        best, *others = most_likely(self.fits)
        return not others and (best.number is not None or not self.unclear(best))

    def _mm_per_px(self) -> float:
        """Return the scale (mm per px) of the image for a tool across the line of sight."""
        first = self.robot.first_marker(self.start)
        spacing = np.linalg.norm(self.robot.tool.second_marker(first) - first)
        points = self.views[0].points
        return float(spacing / np.linalg.norm(points[1] - points[0]))

    def _blindly_doubled(self) -> Floats:
        """Return the motions (3,) doubled where that is safe under any hypothesis; 0 elsewhere."""
        predicted, observed = self.motions / self._per_mm, self.displacement * self._mm_per_px()
        noise = NOISE_DEVIATIONS * self.views[0].mean_noise * self._mm_per_px()
        is_small = (predicted < BLIND_MM) & (observed < BLIND_MM)
        is_small &= observed < BLIND_RATIO * predicted + noise
        return np.where(is_small, 2.0 * self.motions, 0.0)

    def _worth_growth(self, joint: int) -> float:
        """Return the next motion (rad or mm); 0 if it is hardly larger than the last one."""
        larger = self.next_motion(joint)
        return larger if larger > MIN_GROWTH * self.motions[joint] else 0.0

    def _largest_travel(self, one: Hypothesis, joint: int, motion: float) -> float:
        """Return the largest travel (mm) of marker 2 within the uncertainty of a hypothesis."""
        sizes = [one.size]
        if one.corrects_counts:
            larger = one.size + SIZE_DEVIATIONS * one.deviation
            sizes = [min(size, MAX_LOG_FACTOR) for size in (one.size, larger)]
        cases = [replace(one, size=size) for size in sizes]
        return max(case.travel(self.robot, self.start, joint, motion) for case in cases)
