"""What only a person can tell, asked.

Picture and encoders do not tell a mirrored picture from one angle that runs the other way, nor both
angles reversed from a camera turned about the tool, nor markers further apart from an insertion
that counts otherwise; nor, from some places, an angle that counts otherwise from another one, or
from another zero of the insertion. Which way the tool went and how far, and a ruler, do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rcmservo.bringup.asking import TIMES, by_ruler, one_of
from rcmservo.bringup.guesses import (
    Guess,
    Weighed,
    members,
    places,
)
from rcmservo.bringup.wiring import Robot
from rcmservo.errors import Stopped
from rcmservo.interfaces import Floats
from rcmservo.live.lab import Person
from rcmservo.method.kinematics import SPHERICAL

LOOKING = {
    True: "look from the point where the tool goes in, along the line theta = 0",
    False: "look from the point where the tool goes in along the tool at q = 0, the yaw axis up",
}
"""From where a person looks: a spherical mechanism's words, or those of yaw and pitch."""

WAYS = {
    True: (("away", "towards"), ("clockwise", "anticlockwise"), ("in", "out")),
    False: (("right", "left"), ("down", "up"), ("in", "out")),
}
"""What the tool does when joint 1, 2 or 3 rises, or falls."""

MEANING = {
    True: "away from that line or towards it, about it clockwise or anticlockwise, or further in "
    "or out",
    False: "right or left, up or down, or further in or out",
}

AGAIN = "again"

RULER = 0.05
"""Share by which a ruler may be off, and in standard deviations of the picture"""
DEVIATIONS = 2.0
"""so many."""

BY_EYE = 1.7
"""Factor by which a way of the tool may be off that was seen,"""
HARDLY = 0.3
"""mm, as which all are taken that are less,"""
APART = 3.0
"""and by which two ways must differ to be told apart."""

Show = Callable[[int], None]
"""Moves a joint up, and back again, so that a person sees it, who has said yes to that."""
Way = Callable[[int], float]
"""How far that is, rad or mm."""


def words(robot: Robot, joint: int, way: int) -> str:
    """What a person calls it when a joint rises (1) or falls (-1)."""
    return WAYS[robot.mechanism.kind == SPHERICAL][joint][0 if way > 0 else 1]


def decided(
    kinds: Sequence[Weighed], robot: Robot, q: Floats, person: Person, show: Show, way: Way
) -> list[Guess]:
    """The guesses that are left of these kinds after a person was asked; several only where the
    answers do not tell either."""
    left = [member for kind in kinds for member in members(kind)]
    for joint in (0, 1, 2):
        if len({one.moves(joint, robot.wiring) for one in left}) > 1:
            left = _by_its_way(left, robot, joint, person, show)
    for length in (_apart(robot, q), _deep(robot, q)):
        if len({length.mm(one) for one in left}) > 1:
            left = _by_ruler(left, length, person)
    ways = [_ways(left, robot, q, joint, way(joint)) for joint in range(3)]
    ratios = [could.max() / could.min() for could in ways]
    joint = int(np.argmax(ratios))
    if ratios[joint] > APART:
        left = _by_how_far(left, ways[joint], _name(robot, joint), person, lambda: show(joint))
    return left


def _by_its_way(
    left: list[Guess], robot: Robot, joint: int, person: Person, show: Show
) -> list[Guess]:
    """Those for which the tool goes where the person saw it go."""
    spherical = robot.mechanism.kind == SPHERICAL
    name = _name(robot, joint)
    choice = [word for pair in WAYS[spherical] for word in pair]
    asked = f"{LOOKING[spherical]}: which way did the tool go first, {MEANING[spherical]}?"
    for _ in range(TIMES):
        person.tell(f"Watch the tool: {name} goes one way, waits, and comes back.")
        show(joint)
        answer = one_of(person, f"For {name}, {asked}", (*choice, AGAIN))
        kept = [one for one in left if words(robot, *one.moves(joint, robot.wiring)) == answer]
        if kept:
            return kept
        if answer != AGAIN:
            could = " or ".join(
                sorted({words(robot, *one.moves(joint, robot.wiring)) for one in left})
            )
            person.tell(f"By the picture it can only have been {could}. It is shown again.")
    raise Stopped(f"no answer agreed with the picture for {name}")


def _name(robot: Robot, joint: int) -> str:
    return f"joint {joint + 1} ({robot.mechanism.joint_names[joint]})"


@dataclass(frozen=True)
class Length:
    """What a ruler can tell of the tool."""

    question: str
    """How it is asked for."""
    between: Callable[[Guess], Floats]
    """The two points (2, 3) mm that it lies between if a guess is true."""

    def mm(self, guess: Guess) -> float:
        """What the ruler shows if a guess is true."""
        between = self.between(guess)
        way: Floats = between[1] - between[0]
        return float(round(np.linalg.norm(way), 6))

    def off(self, guess: Guess, measured: float) -> float:
        """By which share something else was measured."""
        return abs(float(np.log(self.mm(guess) / measured)))

    def may_be_off(self, guess: Guess) -> float:
        """By which share it may be, of a guess that is true."""
        longer = replace(guess, size=guess.size + DEVIATIONS * guess.within)
        return RULER + self.off(guess, self.mm(longer))


def _apart(robot: Robot, q: Floats) -> Length:
    question = "By the ruler: how far apart are the middles of the two markers, in mm?"
    return Length(question, lambda guess: _markers(guess, robot, q))


def _deep(robot: Robot, q: Floats) -> Length:
    question = (
        "By the ruler: how far is the middle of marker 1 from the point where the tool goes in, "
        "about which it turns, in mm?"
    )

    def between(guess: Guess) -> Floats:
        return np.array([np.zeros(3), _markers(guess, robot, q)[0]])

    return Length(question, between)


def _markers(guess: Guess, robot: Robot, q: Floats) -> Floats:
    """The markers (2, 3) mm, seen from the RCM, where the check began."""
    return places(guess, robot, q[None], q, guess.size)[0]


def _by_ruler(left: list[Guess], length: Length, person: Person) -> list[Guess]:
    """Those that have it as long as the ruler; all of them where nobody can measure it."""
    could = " or ".join(f"{mm:.3g}" for mm in sorted({length.mm(one) for one in left}))
    for _ in range(TIMES):
        measured = by_ruler(person, length.question, least=0.5)
        if measured is None:
            return left
        kept = [one for one in left if length.off(one, measured) <= length.may_be_off(one)]
        if kept:
            return kept
        person.tell(f"By the picture it can only be about {could} mm. Measure it again.")
    raise Stopped(f"the ruler agreed with the picture's {could} mm in no answer")


def _ways(left: list[Guess], robot: Robot, q: Floats, joint: int, way: float) -> Floats:
    """mm that marker 2 goes when a joint goes so far, if each of these is true; HARDLY at least."""
    there = np.stack([q, q])
    there[1, joint] += way
    both = (places(one, robot, there, q, one.size)[:, 1] for one in left)
    ways: list[Floats] = [second[1] - second[0] for second in both]
    return np.array([max(float(np.linalg.norm(way)), HARDLY) for way in ways])


def _by_how_far(
    left: list[Guess], could: Floats, name: str, person: Person, show: Callable[[], None]
) -> list[Guess]:
    """Those for which marker 2 goes about as far, mm, as the person saw; all of them where nobody
    can tell."""
    question = f"For {name}, by the ruler: about how many mm did marker 2 go (0: hardly any)?"
    for _ in range(TIMES):
        person.tell(
            f"Watch marker 2, with a ruler beside it: {name} goes one way, waits, and comes back."
        )
        show()
        seen = by_ruler(person, question, least=0.0)
        if seen is None:
            return left
        near = np.abs(np.log(could / max(seen, HARDLY))) < np.log(BY_EYE)
        if near.any():
            return [one for one, kept in zip(left, near, strict=True) if kept]
        mm = " or ".join(f"{way:.2g}" for way in sorted(could))
        person.tell(f"By the picture it can only have been about {mm} mm. It is shown again.")
    raise Stopped(f"no answer agreed with the picture for {name}")
