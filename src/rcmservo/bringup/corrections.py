"""Findings that follow from a hypothesis, with the lines that correct the rig file."""

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.findings import Finding
from rcmservo.bringup.hypotheses import Hypothesis
from rcmservo.bringup.identification import SPACING, ZERO, scale_spacing
from rcmservo.geometry.tool import RIGID

MIRRORED = Finding(
    "the picture is mirrored",
    "camera",
    "left and right exchanged",
    "not mirrored: disable mirroring in the camera or its streaming software",
)


def corrections(hypothesis: Hypothesis, robot: Robot) -> list[Finding]:
    """Return the findings if `hypothesis` is true, with the lines that correct the rig file."""
    found = [*_order(hypothesis, robot), *_counts(hypothesis, robot)]
    if hypothesis.number == ZERO:
        zero = robot.mechanism.insertion_zero
        corrected, deviation = zero + hypothesis.size, hypothesis.deviation
        value = f"{corrected:.1f} mm ± {deviation:.1f} mm"
        what, line = "the zero of the insertion differs", f"insertion_zero = {corrected:.1f}"
        found.append(Finding(what, "mechanism.insertion_zero", f"{zero:g} mm", value, line))
    if hypothesis.number == SPACING:
        tool = robot.tool
        corrected = scale_spacing(tool.struct, hypothesis.size).value
        key, unit = ("spacing", " mm") if tool.kind == RIGID else ("scale", "")
        value = f"{corrected:.4g}{unit} ± {100 * hypothesis.deviation:.1g} %"
        what, line = "the distance between the markers differs", f"{key} = {corrected:.4g}"
        found.append(Finding(what, f"tool.{key}", f"{tool.value:g}{unit}", value, line))
    return [*found, MIRRORED] if hypothesis.mirrored else found


def describe(hypothesis: Hypothesis, robot: Robot) -> str:
    """Return a hypothesis as text."""
    found = [f"{one.where}: {one.what}" for one in corrections(hypothesis, robot)]
    return "; ".join(found or ["the rig file is correct"])


def _order(hypothesis: Hypothesis, robot: Robot) -> list[Finding]:
    order, letters = hypothesis.order, robot.wiring.reordered(hypothesis.order)
    changed = [j for j in range(3) if order[j] != j]
    if not changed:
        return []
    found = "; ".join(f"joint {order[j] + 1} moves joint {j + 1}" for j in changed)
    what = "axes are exchanged"
    if letters:
        return [Finding(what, "arm.axes", found, letters, f'axes = "{letters}"')]
    return [Finding(what, "arm", found, "each joint driven by its own axis")]


def _counts(hypothesis: Hypothesis, robot: Robot) -> list[Finding]:
    wiring, factors = robot.wiring, hypothesis.counts_factors
    line, found = wiring.corrected_line(factors), list[Finding]()
    for joint in np.flatnonzero(factors != 1.0):
        value, details = wiring.counts[joint], list[str]()
        if factors[joint] < 0.0:
            details.append("it is reversed")
        if hypothesis.number == joint:
            times, percent = np.exp(hypothesis.size), 100 * hypothesis.deviation
            details.append(f"its motion is {times:.4g} times as large (± {percent:.1g} %)")
        what = f"joint {joint + 1} contradicts its {wiring.key}: {' and '.join(details)}"
        where = f"arm.{wiring.key}[{joint}]" if line else "arm"
        found.append(Finding(what, where, f"{value:g}", f"{value * factors[joint]:.6g}", line))
    return found


def describe_undetectable_error(fit: Hypothesis, robot: Robot) -> str:
    """Return as text the largest error of a setting that the image would not reveal."""
    number, size = fit.number, fit.undetectable
    assert number is not None
    if number == ZERO:
        return f"mechanism.insertion_zero may have an undetected error of {size:.0f} mm"
    if number == SPACING:
        where = "tool.spacing" if robot.tool.kind == RIGID else "tool.scale"
    elif robot.wiring.has_signs_only:
        where = f"the scale of joint {number + 1}"
    else:
        where = f"arm.counts[{number}]"
    return f"{where} may have an undetected error of {100.0 * (np.exp(size) - 1.0):.0f} %"
