"""Moving all joints further and further, until the picture tells what is wrong, if anything.

The first motions are so small that no usual mistake makes them large. Each is doubled only after a
yes, and only as long as marker 2 stays near, whichever of the guesses that are left is true.
"""

from dataclasses import replace

import numpy as np

from rcmservo.bringup.asking import agreed
from rcmservo.bringup.guesses import COUNTS, SPACING, ZERO, Weighed, believed, judge_all, places
from rcmservo.bringup.motion import Mover, Sight
from rcmservo.bringup.view import Views
from rcmservo.bringup.wiring import Robot
from rcmservo.interfaces import Floats
from rcmservo.live.lab import Person

FIRST = 0.06
"""mm that marker 2 goes at first, as the rig file says: an inch taken for a mm makes it 1.5."""
MOST = 1.5
"""mm by which it goes at most, by all that is known."""
BLIND = 0.4
"""mm up to which a way is doubled before guesses are judged,"""
MORE = 3.0
"""as long as the picture does not show this many times what the file says."""
WORTH = 1.15
"""How much further a way must become to be worth it."""
LEAST_NOISE, MOST_NOISE = 0.03, 0.15
"""px to which a mean over frames is believed at best, and at worst: what the best guess leaves over
is taken for the tracker's own error, as of pictures that were compressed."""
DEVIATIONS = 2.0
"""How many standard deviations a wrong number may be off at worst."""

CLEAR = {ZERO: 4.0, COUNTS: 0.15, SPACING: 0.05}
"""To what standard deviation a number must be known before it can be called right: mm, and the
logarithms of factors."""


class Ranging:
    """The motions and what was seen, round by round."""

    def __init__(self, mover: Mover, person: Person, robot: Robot, rest: Sight) -> None:
        self.mover, self.person, self.robot = mover, person, robot
        self.start = rest.q
        self.sights = [rest]
        self.judged: list[Weighed] = []
        """All guesses, the best first."""
        self.ways = FIRST * np.array([robot.way(rest.q, joint) for joint in range(3)])
        """rad, rad, mm that each joint went last, to either side."""
        self.noise = LEAST_NOISE
        """px, what a mean over frames is believed to."""
        self.shown = np.zeros(3)
        """px by which a marker moved then."""

    def run(self) -> list[Weighed]:
        """Go on until the guesses are told apart, or until it would become too far."""
        active = [0, 1, 2]
        while active:
            for joint in active:
                self._move(joint)
            further = self._further_blindly()
            if not any(further):
                self._judge()
                if self._clear():
                    break
                further = np.array([self._allowed(joint) for joint in range(3)])
            active = [joint for joint in range(3) if further[joint] > self.ways[joint]]
            self.ways = np.where(further > 0.0, further, self.ways)
        return believed(self.judged)

    def _judge(self) -> None:
        """Weigh all guesses, by what the best of them leaves over."""
        seen = self.seen()
        self.judged = judge_all(self.robot, seen)
        rough = float(np.sqrt(self.judged[0].misfit / seen.points.size))
        if rough > 1.0 and self.noise < MOST_NOISE:
            self.noise = min(self.noise * rough, MOST_NOISE)
            self.judged = judge_all(self.robot, self.seen())

    def seen(self) -> Views:
        """All that was seen."""
        q, points = (np.stack([getattr(s, name) for s in self.sights]) for name in ("q", "points"))
        noise = np.array([max(sight.mean_noise, self.noise) for sight in self.sights])
        return Views(q, points, noise, self.mover.size)

    def question(self, joint: int, way: float, words: str = "") -> str:
        """How a motion is asked for."""
        name = self.robot.mechanism.joint_names[joint]
        counts = abs(way * self.robot.wiring.counts[joint])
        unit = f"{way:.3g} mm" if joint == 2 else f"{np.degrees(way):.3g} deg"
        size = f"{counts:.0f} counts" if not self.robot.wiring.signs_only else unit
        return f"Move joint {joint + 1} ({name}) by at most {size}{words}, and back?"

    def _move(self, joint: int) -> None:
        way = float(self.ways[joint])
        agreed(self.person, self.question(joint, way, " either way"))
        new = self.mover.there_and_back(joint, (way, -way))
        moved = [np.linalg.norm(s.points - self.sights[0].points, axis=1).max() for s in new[:2]]
        self.shown[joint] = max(moved)
        self.sights += new

    def _further_blindly(self) -> Floats:
        """The ways doubled where that is safe before any guess is judged; 0 elsewhere."""
        said = self.ways / [self.robot.way(self.start, joint) for joint in range(3)]
        between = self.sights[0].points[1] - self.sights[0].points[0]
        apart = self.robot.tool.second_marker(self.robot.first(self.start))
        mm = np.linalg.norm(apart - self.robot.first(self.start)) / np.linalg.norm(between)
        shown = self.shown * mm
        noise = 5.0 * self.sights[0].mean_noise * mm
        small = (said < BLIND) & (shown < BLIND) & (shown < MORE * said + noise)
        return np.where(small, 2.0 * self.ways, 0.0)

    def farthest_way(self, joint: int) -> float:
        """The way (rad or mm) that is not too far for any guess that is left."""
        left = [one for one in self.judged if one.close(self.judged[0])]
        way = float(self.ways[joint])
        return way * MOST / max(self._farthest(one, joint, way) for one in left)

    def _allowed(self, joint: int) -> float:
        """The way doubled, or less where that would be too far; 0 where it is not worth it."""
        way = float(self.ways[joint])
        longer = min(2.0 * way, self.farthest_way(joint))
        return longer if longer > WORTH * way else 0.0

    def _farthest(self, one: Weighed, joint: int, way: float) -> float:
        """mm that marker 2 goes if a guess is true."""
        q = np.stack([self.start, self.start])
        q[1, joint] += way
        sizes = [one.guess.size]
        if one.guess.wrong == COUNTS:
            sizes.append(one.guess.size + DEVIATIONS * one.within)
        at = [places(one.guess, self.robot, q, self.start, min(size, 5.0))[:, 1] for size in sizes]
        return max(float(np.linalg.norm(there - here)) for here, there in at)

    def _clear(self) -> bool:
        """Whether one guess is left, and if it needs no wrong number, all numbers are known well
        enough to say so."""
        left = believed(self.judged)
        if len(left) != 1 or left[0].guess.wrong:
            return len(left) == 1
        guess = left[0].guess
        same = [o for o in self.judged if replace(o.guess, wrong="", joint=0, size=0.0) == guess]
        return all(one.within <= CLEAR[one.guess.wrong] for one in same if one.guess.wrong)
