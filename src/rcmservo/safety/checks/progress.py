"""Detectors of obstacles on the way to the target."""

from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import TickFacts


@compiled
def target_is_old(c: TickFacts) -> bool:
    """Detect a target taught before the camera was moved."""
    return c.taught < c.progress.moved


@compiled
def joint_1_blocks_the_path(c: TickFacts) -> bool:
    """Detect that the limit of joint 1 stands in the way."""
    return c.tour.done and c.progress.blocked == 0


@compiled
def joint_2_blocks_the_path(c: TickFacts) -> bool:
    """Detect that the limit of joint 2 stands in the way."""
    return c.tour.done and c.progress.blocked == 1


@compiled
def joint_3_blocks_the_path(c: TickFacts) -> bool:
    """Detect that the limit of joint 3 stands in the way."""
    return c.tour.done and c.progress.blocked == 2


@compiled
def tool_is_elsewhere(c: TickFacts) -> bool:
    """Detect joints that for some time contradict an image of the tool at the target."""
    since, t = c.progress.astray, c.thresholds
    return c.tour.done and since >= 0 and c.seen.now - since > t.elsewhere_time * 1e9


@compiled
def path_is_singular(c: TickFacts) -> bool:
    """Detect a singular surface that closes the path."""
    return c.tour.done and not c.progress.open >= c.thresholds.closed


@compiled
def path_is_nearly_singular(c: TickFacts) -> bool:
    """Detect a singular surface that nearly closes the path."""
    return c.tour.done and not c.progress.open >= c.thresholds.nearly_closed


@compiled
def progress_stalled(c: TickFacts) -> bool:
    """Detect an error that has stopped falling."""
    t, since = c.thresholds, c.progress.peak_time
    patience = max(t.stall_time, t.stall_gains / c.gain)
    is_late = c.seen.now - since > patience * 1e9
    return c.tour.done and c.progress.peak > t.stall_error and is_late
