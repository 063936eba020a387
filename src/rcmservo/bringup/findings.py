"""What a guess says is wrong with the rig file, in words and lines."""

import numpy as np

from rcmservo.bringup.guesses import (
    COUNTS,
    SPACING,
    ZERO,
    Guess,
    Weighed,
    passing,
    stretched,
)
from rcmservo.bringup.wiring import Finding, Robot
from rcmservo.method.tool import RIGID


def findings(guess: Guess, robot: Robot) -> list[Finding]:
    """What a guess says is wrong with the rig file, and the lines that make it right."""
    found = [*_order(guess, robot), *_counts(guess, robot)]
    if guess.wrong == ZERO:
        found.append(_zero(guess, robot))
    if guess.wrong == SPACING:
        found.append(_spacing(guess, robot))
    if guess.mirrored:
        found.append(
            Finding(
                "the picture is mirrored",
                "camera",
                "left and right change places",
                "as the eye sees it: switch mirroring off at the camera, or in what sends it",
            )
        )
    return found


def _order(guess: Guess, robot: Robot) -> list[Finding]:
    if guess.order == (0, 1, 2):
        return []
    wiring = robot.wiring
    changed = [j + 1 for j in range(3) if guess.order[j] != j]
    found = "; ".join(f"joint {guess.order[j - 1] + 1} moves joint {j}" for j in changed)
    letters = wiring.reordered(guess.order) if wiring.axes else ""
    line = f'axes = "{letters}"' if letters else ""
    expected = letters or "each joint moved by its own"
    where = "arm.axes" if letters else "arm"
    return [Finding("axes change places", where, found, expected, line)]


def _counts(guess: Guess, robot: Robot) -> list[Finding]:
    wiring, factors = robot.wiring, guess.factors()
    found: list[Finding] = []
    for joint, factor in enumerate(factors):
        if factor == 1.0:
            continue
        value = wiring.counts[joint]
        ways: list[str] = []
        if factor < 0.0:
            ways.append("it runs the other way")
        if guess.wrong == COUNTS and guess.joint == joint:
            ways.append(
                f"it moves {np.exp(guess.size):.4g} times as far, to {100 * guess.within:.1g} %"
            )
        found.append(
            Finding(
                f"joint {joint + 1} is not as its {wiring.key} say: {' and '.join(ways)}",
                f"arm.{wiring.key}[{joint}]" if wiring.line(factors) else "arm",
                f"{value:g}",
                f"{value * factor:.6g}",
                wiring.line(factors),
            )
        )
    return found


def may_pass(one: Weighed, robot: Robot) -> str:
    """That a number may be wrong by so much without the picture telling it, in words."""
    wrong, by = one.guess.wrong, passing(one)
    if wrong == ZERO:
        return f"mechanism.insertion_zero may be wrong by {by:.0f} mm unseen"
    if wrong == SPACING:
        where = "tool.spacing" if robot.tool.kind == RIGID else "tool.scale"
    elif robot.wiring.signs_only:
        where = f"how far joint {one.guess.joint + 1} goes"
    else:
        where = f"arm.counts[{one.guess.joint}]"
    return f"{where} may be wrong by {100.0 * (np.exp(by) - 1.0):.0f} % unseen"


def _zero(guess: Guess, robot: Robot) -> Finding:
    zero = robot.mechanism.insertion_zero
    right = zero + guess.size
    return Finding(
        "the insertion's zero is elsewhere",
        "mechanism.insertion_zero",
        f"{zero:g} mm",
        f"{right:.1f} mm, to {guess.within:.1f} mm",
        f"insertion_zero = {right:.1f}",
    )


def _spacing(guess: Guess, robot: Robot) -> Finding:
    tool = robot.tool
    right = stretched(tool.shaft, guess.size).value
    key, unit = ("spacing", " mm") if tool.kind == RIGID else ("scale", "")
    return Finding(
        "the markers are otherwise apart",
        f"tool.{key}",
        f"{tool.value:g}{unit}",
        f"{right:.4g}{unit}, to {100 * guess.within:.1g} %",
        f"{key} = {right:.4g}",
    )
