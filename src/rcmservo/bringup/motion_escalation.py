"""Motions of growing size of all joints, until the image identifies the error of the rig file.

The first motions are so small that no common error of a rig file makes them dangerous. A motion is
doubled only after the operator agrees, and only while the travel of marker 2 stays small under
every hypothesis that remains.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.bringup.approach_direction import (
    compute_ends,
    find_directions,
    find_known_views,
    find_taken_up,
)
from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.backlash import Backlash, measure_backlash
from rcmservo.bringup.hypotheses import Hypothesis, fit_all, select_most_likely
from rcmservo.bringup.identification import MarkerViews
from rcmservo.bringup.motion import Mover
from rcmservo.bringup.observations import JointMotion, PixelBound, StillView
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
        self._rest = rest
        self._made: list[JointMotion] = []
        """Motions so far."""
        self.fits: list[Hypothesis] = []
        """One fitted hypothesis of each class, by increasing misfit."""
        self._joint_per_mm = robot.compute_joint_per_mm(rest.q)
        max_motion = FIRST_COUNTS * robot.wiring.steps
        self.motions = np.minimum(FIRST_MM * self._joint_per_mm, max_motion)
        """Last motion (3,) of each joint in either direction in rad, rad, mm."""
        self.displacement = np.zeros(3)
        """Largest displacement (3,) of a marker in px during the last motion of each joint."""
        self._displaced_by = self.motions.copy()
        """Motion (3,) of each joint to which `displacement` belongs."""
        self._noise_px = MIN_NOISE_PX
        """Lower bound on the noise of a mean over frames, raised to the residuals of the fits."""

    @property
    def start(self) -> Floats:
        """Joints (3,) at the start of the check."""
        return self._rest.q

    def run(self, test_moved_joint: Callable[[int], None]) -> list[Hypothesis]:
        """Move until one hypothesis remains or the next motion would be too large.

        If joints have backlash, move until there are views after each of them has taken it up.

        Parameters
        ----------
        test_moved_joint
            Called once, with the first joint that moves visibly in the image and by
            `MIN_MOTION_STEPS` counts.

        Returns
        -------
        list[Hypothesis]
            Most likely hypotheses.
        """
        active, is_untested = [0, 1, 2], True
        while active:
            for joint in active:
                self._move(joint)
                if is_untested and self._has_moved(joint):
                    test_moved_joint(joint)
                    is_untested = False
            larger = self._double_small_motions()
            if not larger.any():
                self._fit()
                if self._is_decided():
                    break
                larger = np.array([self._grow_motion(joint) for joint in range(3)])
            active = [joint for joint in range(3) if larger[joint] > self.motions[joint]]
            if not active and self._needs_repetition():
                active = [0, 1, 2]
            self.motions = np.where(larger > 0.0, larger, self.motions)
        if is_untested:
            test_moved_joint(int(np.argmax(self.displacement)))
        return select_most_likely(self.fits)

    def collect_views(self) -> MarkerViews:
        """Return the views with the noise of each.

        If joints have backlash, return only the views after each of them has taken it up, as soon
        as there are some.
        """
        first = find_known_views(self._made) or 0
        views = [self._rest, *(view for motion in self._made for view in motion.views)][first:]
        q, points = np.stack([v.q for v in views]), np.stack([v.points for v in views])
        noise = np.array([max(view.mean_noise, self._noise_px) for view in views])
        descended = find_directions(self._made)[first:]
        return MarkerViews(q, points, noise, self.mover.size, descended)

    def measure_backlash(self) -> list[Backlash]:
        """Return the backlash of each joint for a correct rig file."""
        first, ends = find_known_views(self._made) or 0, compute_ends(self._made)
        known = [motion for motion, end in zip(self._made, ends, strict=True) if end >= first]
        return measure_backlash(self.robot, self.collect_views(), known)

    def format_question(self, joint: int, motion: float, details: str = "") -> str:
        """Return the question to the operator whether a motion (rad or mm) is allowed."""
        size = f"{abs(motion * self.robot.wiring.counts[joint]):.0f} counts"
        if self.robot.wiring.has_signs_only:
            size = f"{motion:.3g} mm" if joint == 2 else f"{np.degrees(motion):.3g} deg"
        return f"Move {self.robot.describe_joint(joint)} by at most {size}{details}, and return?"

    def compute_bound(self, joint: int, motion: float) -> PixelBound:
        """Return the bound on the markers in the image for a motion (rad or mm) of a joint."""
        mm_per_px, rest = self._compute_mm_per_px(), self._rest
        predicted_px = motion / self._joint_per_mm[joint] / mm_per_px
        observed_px = self.displacement[joint] * motion / self._displaced_by[joint]
        predicted_px = max(predicted_px, observed_px)
        margin_px = ABORT_MM / mm_per_px + 2.0 * NOISE_DEVIATIONS * rest.noise
        return PixelBound(rest.points, ABORT_RATIO * predicted_px + margin_px)

    def choose_next_motion(self, joint: int) -> float:
        """Return the next motion (rad or mm): twice the last one, or less.

        It is less if marker 2 would otherwise travel more than `MAX_TRAVEL_MM` under a remaining
        hypothesis. Until each joint has taken up its backlash, a correct file counts as one.
        """
        motion = float(self.motions[joint])
        remaining = [fit for fit in self.fits if fit.is_close(self.fits[0])]
        remaining += [Hypothesis()] if find_known_views(self._made) is None else []
        travel_mm = max(self._predict_largest_travel(fit, joint, motion) for fit in remaining)
        return motion * min(2.0, MAX_TRAVEL_MM / travel_mm)

    def find_unclear(self, plain: Hypothesis) -> list[Hypothesis]:
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
        require_yes(self.operator, self.format_question(joint, motion, " in either direction"))
        views = self.mover.visit(joint, (motion, -motion), self.compute_bound(joint, motion))
        home = self._rest.points
        distances = [np.linalg.norm(view.points - home, axis=1).max() for view in views[:2]]
        self.displacement[joint], self._displaced_by[joint] = max(distances), motion
        self._made.append(JointMotion(joint, motion, views))

    def _has_moved(self, joint: int) -> bool:
        """Return whether image and encoder both confirm a motion."""
        is_visible = self.displacement[joint] > NOISE_DEVIATIONS * self._rest.mean_noise
        steps = self.motions[joint] / self.robot.wiring.steps[joint]
        return bool(is_visible and steps >= MIN_MOTION_STEPS)

    def _fit(self) -> None:
        """Fit all hypotheses; raise the noise to the residuals of the best one and fit again."""
        if find_known_views(self._made):
            self._noise_px = MIN_NOISE_PX  # earlier residuals were those of unknown backlash
        views = self.collect_views()
        self.fits = fit_all(self.robot, views)
        ratio = float(np.sqrt(self.fits[0].misfit / views.points.size))
        if ratio > 1.0 and self._noise_px < MAX_NOISE_PX:
            self._noise_px = min(self._noise_px * ratio, MAX_NOISE_PX)
            self.fits = fit_all(self.robot, self.collect_views())

    def _is_decided(self) -> bool:
        """Return whether one hypothesis remains and no other number may have a large error."""
        if find_known_views(self._made) is None:
            return False
        best, *others = select_most_likely(self.fits)
        return not others and (best.number is not None or not self.find_unclear(best))

    def _needs_repetition(self) -> bool:
        """Return whether motions of the present size have yet to follow the take-up of backlash."""
        return find_taken_up(self._made) is not None and find_known_views(self._made) is None

    def _compute_mm_per_px(self) -> float:
        """Return the scale (mm per px) of the image for a tool across the line of sight."""
        marker_1 = self.robot.compute_first_marker(self.start)
        spacing_mm = np.linalg.norm(self.robot.tool.second_marker(marker_1) - marker_1)
        vector_px: Floats = np.diff(self._rest.points, axis=0)
        return float(spacing_mm / np.linalg.norm(vector_px))

    def _double_small_motions(self) -> Floats:
        """Return the motions (3,) doubled where that is safe under any hypothesis; 0 elsewhere."""
        mm_per_px = self._compute_mm_per_px()
        predicted_mm, observed_mm = self.motions / self._joint_per_mm, self.displacement * mm_per_px
        noise_mm = NOISE_DEVIATIONS * self._rest.mean_noise * mm_per_px
        is_small = (predicted_mm < BLIND_MM) & (observed_mm < BLIND_MM)
        is_small &= observed_mm < BLIND_RATIO * predicted_mm + noise_mm
        return np.where(is_small, 2.0 * self.motions, 0.0)

    def _grow_motion(self, joint: int) -> float:
        """Return the next motion (rad or mm); 0 if it is hardly larger than the last one."""
        larger = self.choose_next_motion(joint)
        return larger if larger > MIN_GROWTH * self.motions[joint] else 0.0

    def _predict_largest_travel(self, fit: Hypothesis, joint: int, motion: float) -> float:
        """Return the largest travel (mm) of marker 2 within the uncertainty of a hypothesis."""
        sizes = [fit.size]
        if fit.corrects_counts:
            larger = fit.size + SIZE_DEVIATIONS * fit.deviation
            sizes = [min(size, MAX_LOG_FACTOR) for size in (fit.size, larger)]
        cases = [replace(fit, size=size) for size in sizes]
        return max(case.compute_travel(self.robot, self.start, joint, motion) for case in cases)
