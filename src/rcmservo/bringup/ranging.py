"""Moving all joints further and further, until the picture tells what is wrong, if anything.

The first motions are so small that no usual mistake makes them large. Each is doubled only after a
yes, and only as long as marker 2 stays near, whichever of the guesses that are left is true.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.bringup.asking import agreed
from rcmservo.bringup.guesses import (
    COUNTS,
    RIGHT,
    SPACING,
    ZERO,
    Guess,
    Weighed,
    believed,
    judge_all,
    passing,
    places,
)
from rcmservo.bringup.motion import Mover
from rcmservo.bringup.sights import Reach, Sight
from rcmservo.bringup.view import Views
from rcmservo.bringup.wiring import Robot
from rcmservo.interfaces import Floats
from rcmservo.live.lab import Person

FIRST = 0.06
"""mm that marker 2 goes at first, as the rig file says,"""
FIRST_COUNTS = 50.0
"""and counts at most: where a file has a thousand times too many of a mm, so few are small yet."""
MOST = 1.5
"""mm by which it goes at most, by all that is known."""
BLIND = 0.4
"""mm up to which a way is doubled before guesses are judged,"""
MORE = 3.0
"""as long as the picture does not show this many times what the file says;"""
BEYOND, ANYWAY = 4.0, 0.5
"""a motion ends where it shows this many times that, and so many mm that may be seen anyway."""
NOISES = 5.0
"""Standard deviations that are nothing."""
TOLD = 20.0
"""Counts of a way on which it can be told whether a joint stops."""
LONGEST = 8.0
"""The logarithm of a factor that is reckoned with at most."""
WORTH = 1.15
"""How much further a way must become to be worth it."""
LEAST_NOISE, MOST_NOISE = 0.03, 0.15
"""px to which a mean over frames is believed at best, and at worst: what the best guess leaves over
is taken for the tracker's own error, as of pictures that were compressed."""
DEVIATIONS = 2.0
"""How many standard deviations a wrong number may be off at worst."""

PROMISED = {ZERO: 5.0, COUNTS: 0.15, SPACING: 0.05}
"""By how much a number may be wrong and pass: mm, and the logarithms of factors."""


class Ranging:
    """The motions and what was seen, round by round."""

    def __init__(self, mover: Mover, person: Person, robot: Robot, rest: Sight) -> None:
        self.mover, self.person, self.robot = mover, person, robot
        self.start = rest.q
        self.sights = [rest]
        self.judged: list[Weighed] = []
        """All guesses, the best first."""
        self._mm = np.array([robot.way(rest.q, joint) for joint in range(3)])
        self.ways = np.minimum(FIRST * self._mm, FIRST_COUNTS * robot.wiring.steps)
        """rad, rad, mm that each joint went last, to either side."""
        self.noise = LEAST_NOISE
        """px, what a mean over frames is believed to."""
        self.shown = np.zeros(3)
        """px by which a marker moved then,"""
        self._gone = self.ways.copy()
        """when the joints went so far."""

    def run(self, moved: Callable[[int], None]) -> list[Weighed]:
        """Go on until the guesses are told apart, or until it would become too far. `moved` is
        called once, with the first joint that was seen to move."""
        active, unmoved = [0, 1, 2], True
        while active:
            for joint in active:
                self._move(joint)
                if unmoved and self._seen_to_move(joint):
                    moved(joint)
                    unmoved = False
            further = self._further_blindly()
            if not any(further):
                self._judge()
                if self._clear():
                    break
                further = np.array([self._allowed(joint) for joint in range(3)])
            active = [joint for joint in range(3) if further[joint] > self.ways[joint]]
            self.ways = np.where(further > 0.0, further, self.ways)
        if unmoved:
            moved(int(np.argmax(self.shown)))
        return believed(self.judged)

    def _seen_to_move(self, joint: int) -> bool:
        """Whether picture and encoder both told it beyond doubt."""
        shown = self.shown[joint] > NOISES * self.sights[0].mean_noise
        return bool(shown and self.ways[joint] >= TOLD * self.robot.wiring.steps[joint])

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
        new = self.mover.there_and_back(joint, (way, -way), self.reach(joint, way))
        moved = [np.linalg.norm(s.points - self.sights[0].points, axis=1).max() for s in new[:2]]
        self.shown[joint], self._gone[joint] = max(moved), way
        self.sights += new

    def reach(self, joint: int, way: float) -> Reach:
        """How far the markers may go in the picture when a joint goes so far."""
        said = way / self._mm[joint] / self._mm_per_px()
        expected = max(said, self.shown[joint] * way / self._gone[joint])
        anyway = ANYWAY / self._mm_per_px() + 2.0 * NOISES * self.sights[0].noise
        return Reach(self.sights[0].points, BEYOND * expected + anyway)

    def _mm_per_px(self) -> float:
        """As the distance between the markers shows it, that lie across the line of sight."""
        between: Floats = self.sights[0].points[1] - self.sights[0].points[0]
        first = self.robot.first(self.start)
        apart = np.linalg.norm(self.robot.tool.second_marker(first) - first)
        return float(apart / np.linalg.norm(between))

    def _further_blindly(self) -> Floats:
        """The ways doubled where that is safe before any guess is judged; 0 elsewhere."""
        said, shown = self.ways / self._mm, self.shown * self._mm_per_px()
        noise = NOISES * self.sights[0].mean_noise * self._mm_per_px()
        small = (said < BLIND) & (shown < BLIND) & (shown < MORE * said + noise)
        return np.where(small, 2.0 * self.ways, 0.0)

    def next_way(self, joint: int) -> float:
        """The way (rad or mm) that may be asked for next: twice the last one, or less where that
        would be too far for a guess that is left."""
        left = [one for one in self.judged if one.close(self.judged[0])]
        way = float(self.ways[joint])
        return way * min(2.0, MOST / max(self._farthest(one, joint, way) for one in left))

    def _allowed(self, joint: int) -> float:
        """The next way, or 0 where it is not worth it."""
        longer = self.next_way(joint)
        return longer if longer > WORTH * self.ways[joint] else 0.0

    def _farthest(self, one: Weighed, joint: int, way: float) -> float:
        """mm that marker 2 goes if a guess is true."""
        q = np.stack([self.start, self.start])
        q[1, joint] += way
        sizes = [one.guess.size]
        if one.guess.wrong == COUNTS:
            longer = one.guess.size + DEVIATIONS * one.guess.within
            sizes = [min(size, LONGEST) for size in (one.guess.size, longer)]
        both = [places(one.guess, self.robot, q, self.start, size)[:, 1] for size in sizes]
        ways: list[Floats] = [second[1] - second[0] for second in both]
        return max(float(np.linalg.norm(way)) for way in ways)

    def _clear(self) -> bool:
        """Whether one guess is left, and if it needs no wrong number, all numbers are known well
        enough to say so."""
        left = believed(self.judged)
        if len(left) != 1 or left[0].guess.wrong:
            return len(left) == 1
        guess = left[0].guess
        return not self.unclear(guess)

    def unclear(self, right: Guess) -> list[Weighed]:
        """The numbers that might be wrong by more than is promised, and the picture would not tell,
        if all else of a guess without a wrong one is true."""
        same = [o for o in self.judged if replace(o.guess, wrong=RIGHT, joint=0, size=0.0) == right]
        wrong = [one for one in same if one.guess.wrong != RIGHT]
        return [one for one in wrong if passing(one) > PROMISED[one.guess.wrong]]
