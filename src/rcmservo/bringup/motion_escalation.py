"""Larger and larger motions of all joints until the picture determines the mistake, if any.

This part is no identification but comes before it: the first motions must be too small for any
usual mistake to make them dangerous, and each is doubled only after a yes, and only while marker 2
stays near under every hypothesis that remains.
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
"""First motion of marker 2 according to the rig file, and in counts at most: in a file with a
thousand times too many counts per mm, so few are still small."""
MAX_TRAVEL_MM = 1.5
"""Largest motion of marker 2 under any remaining hypothesis."""
BLIND_MM, BLIND_RATIO = 0.4, 3.0
"""Motion (mm) up to which the next one is doubled before hypotheses are fitted, while the picture
shows less than this many times what the file predicts."""
ABORT_RATIO, ABORT_MM = 4.0, 0.5
"""A motion turns back if the picture shows so many times the prediction, and so many mm."""
NOISE_DEVIATIONS = 5.0
"""Standard deviations of the picture that are no motion."""
MIN_MOTION_STEPS = 20.0
"""Counts of a motion that show whether an arm stops."""
MAX_LOG_FACTOR, SIZE_DEVIATIONS = 8.0, 2.0
"""Largest factor of a motion that is considered (its logarithm), and the standard deviations by
which a fitted one may be larger."""
MIN_GROWTH = 1.15
"""Factor by which a motion must grow to be repeated."""
MIN_NOISE_PX, MAX_NOISE_PX = 0.03, 0.15
"""Bounds of the noise of a mean over frames: the residuals of the best hypothesis count as the
tracker's own error, as of compressed pictures."""
MAX_UNDETECTABLE = 0.15, 0.15, 0.15, 5.0, 0.05
"""Corrections (see `CORRECTION_PRIOR`) that may go undetected without notice."""


class MotionEscalation:
    """Motions of growing size and all that was observed."""

    def __init__(
        self, mover: Mover, person: OperatorTerminal, robot: Robot, rest: StillView
    ) -> None:
        self.mover, self.person, self.robot = mover, person, robot
        self.views = [rest]
        self.fits: list[Hypothesis] = []
        """One hypothesis of each kind, the best first."""
        self._per_mm = robot.joint_per_mm(rest.q)
        self.motions = np.minimum(FIRST_MM * self._per_mm, FIRST_COUNTS * robot.wiring.steps)
        """Last motion (3,) of each joint to either side in rad, rad, mm."""
        self.shown = np.zeros(3)
        """Largest motion (3,) of a marker in it, px,"""
        self._shown_by = self.motions.copy()
        """and the motion of the joint that it belongs to."""
        self._noise = MIN_NOISE_PX

    @property
    def start(self) -> Floats:
        """The joints (3,) where the check began."""
        return self.views[0].q

    def run(self, first_moved: Callable[[int], None]) -> list[Hypothesis]:
        """Move until one hypothesis remains or the next motion would be too large.

        `first_moved` is called once, with the first joint whose motion picture and encoder show.
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
            first_moved(int(np.argmax(self.shown)))
        return most_likely(self.fits)

    def marker_views(self) -> MarkerViews:
        """Return all views with their noise."""
        q, points = np.stack([v.q for v in self.views]), np.stack([v.points for v in self.views])
        noise = np.array([max(view.mean_noise, self._noise) for view in self.views])
        return MarkerViews(q, points, noise, self.mover.size)

    def question(self, joint: int, motion: float, words: str = "") -> str:
        """Return the question whether a motion (rad or mm) is allowed."""
        size = f"{abs(motion * self.robot.wiring.counts[joint]):.0f} counts"
        if self.robot.wiring.signs_only:
            size = f"{motion:.3g} mm" if joint == 2 else f"{np.degrees(motion):.3g} deg"
        return f"Move {self.robot.name(joint)} by at most {size}{words}, and back?"

    def bound(self, joint: int, motion: float) -> PixelBound:
        """Return the bound on the markers in the picture for a motion of a joint."""
        predicted = motion / self._per_mm[joint] / self._mm_per_px()
        predicted = max(predicted, self.shown[joint] * motion / self._shown_by[joint])
        rest = self.views[0]
        margin = ABORT_MM / self._mm_per_px() + 2.0 * NOISE_DEVIATIONS * rest.noise
        return PixelBound(rest.points, ABORT_RATIO * predicted + margin)

    def next_motion(self, joint: int) -> float:
        """Return the motion (rad or mm) that may follow: twice the last one, or less where that is
        too far under a remaining hypothesis.
        """
        motion = float(self.motions[joint])
        left = [fit for fit in self.fits if fit.is_close(self.fits[0])]
        travel = max(self._largest_travel(one, joint, motion) for one in left)
        return motion * min(2.0, MAX_TRAVEL_MM / travel)

    def unclear(self, plain: Hypothesis) -> list[Hypothesis]:
        """Return the fits of `plain` with one number corrected that may need more than
        `MAX_UNDETECTABLE` without being detected.
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
        require_yes(self.person, self.question(joint, motion, " either way"))
        new = self.mover.visit(joint, (motion, -motion), self.bound(joint, motion))
        moved = [np.linalg.norm(v.points - self.views[0].points, axis=1).max() for v in new[:2]]
        self.shown[joint], self._shown_by[joint] = max(moved), motion
        self.views += new

    def _has_moved(self, joint: int) -> bool:
        """Return whether picture and encoder both show a motion beyond doubt."""
        visible = self.shown[joint] > NOISE_DEVIATIONS * self.views[0].mean_noise
        steps = self.motions[joint] / self.robot.wiring.steps[joint]
        return bool(visible and steps >= MIN_MOTION_STEPS)

    def _fit(self) -> None:
        """Fit all hypotheses, with the noise that the residuals of the best one show."""
        views = self.marker_views()
        self.fits = fit_all(self.robot, views)
        ratio = float(np.sqrt(self.fits[0].misfit / views.points.size))
        if ratio > 1.0 and self._noise < MAX_NOISE_PX:
            self._noise = min(self._noise * ratio, MAX_NOISE_PX)
            self.fits = fit_all(self.robot, self.marker_views())

    def _is_decided(self) -> bool:
        """Return whether one hypothesis is left and, if it corrects no number, all numbers are
        known well enough.
        """
        best, *others = most_likely(self.fits)
        return not others and (best.number is not None or not self.unclear(best))

    def _mm_per_px(self) -> float:
        """Return the scale of the picture if the tool lies across the line of sight."""
        first = self.robot.first_marker(self.start)
        spacing = np.linalg.norm(self.robot.tool.second_marker(first) - first)
        points = self.views[0].points
        return float(spacing / np.linalg.norm(points[1] - points[0]))

    def _blindly_doubled(self) -> Floats:
        """Return the motions (3,) doubled where that is safe under any hypothesis; 0 elsewhere."""
        predicted, shown = self.motions / self._per_mm, self.shown * self._mm_per_px()
        noise = NOISE_DEVIATIONS * self.views[0].mean_noise * self._mm_per_px()
        is_small = (predicted < BLIND_MM) & (shown < BLIND_MM)
        is_small &= shown < BLIND_RATIO * predicted + noise
        return np.where(is_small, 2.0 * self.motions, 0.0)

    def _worth_growth(self, joint: int) -> float:
        """Return the next motion, or 0 if it grows too little."""
        larger = self.next_motion(joint)
        return larger if larger > MIN_GROWTH * self.motions[joint] else 0.0

    def _largest_travel(self, one: Hypothesis, joint: int, motion: float) -> float:
        """Return the largest travel (mm) of marker 2 under a hypothesis and its uncertainty."""
        sizes = [one.size]
        if one.corrects_counts:
            larger = one.size + SIZE_DEVIATIONS * one.deviation
            sizes = [min(size, MAX_LOG_FACTOR) for size in (one.size, larger)]
        cases = [replace(one, size=size) for size in sizes]
        return max(case.travel(self.robot, self.start, joint, motion) for case in cases)
