"""Findings that follow from a hypothesis about a rig file, with the lines that correct the file."""

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


def list_corrections(hypothesis: Hypothesis, robot: Robot) -> list[Finding]:
    """Return the findings if `hypothesis` is true, with the lines that correct the rig file."""
    findings = [*_correct_order(hypothesis, robot), *_correct_counts(hypothesis, robot)]
    if hypothesis.number == ZERO:
        zero = robot.mechanism.insertion_zero
        corrected, deviation = zero + hypothesis.size, hypothesis.deviation
        expected = f"{corrected:.1f} mm ± {deviation:.1f} mm"
        what, line = "the zero of the insertion differs", f"insertion_zero = {corrected:.1f}"
        findings.append(Finding(what, "mechanism.insertion_zero", f"{zero:g} mm", expected, line))
    if hypothesis.number == SPACING:
        tool = robot.tool
        corrected = scale_spacing(tool.struct, hypothesis.size).value
        key, unit = ("spacing", " mm") if tool.kind == RIGID else ("scale", "")
        expected = f"{corrected:.4g}{unit} ± {100 * hypothesis.deviation:.1g} %"
        what, line = "the distance between the markers differs", f"{key} = {corrected:.4g}"
        findings.append(Finding(what, f"tool.{key}", f"{tool.value:g}{unit}", expected, line))
    return [*findings, MIRRORED] if hypothesis.mirrored else findings


def describe_hypothesis(hypothesis: Hypothesis, robot: Robot) -> str:
    """Return a hypothesis in words."""
    mistakes = [f"{found.where}: {found.what}" for found in list_corrections(hypothesis, robot)]
    return "; ".join(mistakes) or "the rig file is correct"


def _correct_order(hypothesis: Hypothesis, robot: Robot) -> list[Finding]:
    """Return the finding that axes are exchanged, if they are."""
    order, letters = hypothesis.order, robot.wiring.reorder_axes(hypothesis.order)
    exchanged = [f"joint {k + 1} moves joint {j + 1}" for j, k in enumerate(order) if j != k]
    if not exchanged:
        return []
    what, found = "axes are exchanged", "; ".join(exchanged)
    if letters:
        return [Finding(what, "arm.axes", found, letters, f'axes = "{letters}"')]
    return [Finding(what, "arm", found, "each joint driven by its own axis")]


def _correct_counts(hypothesis: Hypothesis, robot: Robot) -> list[Finding]:
    """Return a finding for each joint whose counts the hypothesis corrects."""
    wiring, factors = robot.wiring, hypothesis.counts_factors
    line, findings = wiring.format_corrected_line(factors), list[Finding]()
    for joint in np.flatnonzero(factors != 1.0):
        counts, details = wiring.counts[joint], list[str]()
        if factors[joint] < 0.0:
            details.append("it is reversed")
        if hypothesis.number == joint:
            factor, percent = np.exp(hypothesis.size), 100 * hypothesis.deviation
            details.append(f"its motion is {factor:.4g} times as large (± {percent:.1g} %)")
        key = wiring.key or "measured values"
        what = f"joint {joint + 1} contradicts its {key}: {' and '.join(details)}"
        where = f"arm.{wiring.key}[{joint}]" if line else "arm"
        found, expected = f"{counts:g}", f"{counts * factors[joint]:.6g}"
        if not wiring.key:
            found = f"q[{joint}] of measure and rates[{joint}] of apply, as they are"
            expected = f"q divided and rates multiplied by {factors[joint]:.4g}"
        findings.append(Finding(what, where, found, expected, line))
    return findings


def describe_undetectable_error(fit: Hypothesis, robot: Robot) -> str:
    """Return in words the largest error of a setting that the image would not reveal."""
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
