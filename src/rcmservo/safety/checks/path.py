"""Detectors of obstacles on the path to the target: joint limits, an old target, a stall.

An obstacle is also a target whose pixels and joints contradict each other, by the prediction before
the motion, or by the image on arrival and after it.
"""

from rcmservo.interfaces import NEVER_NS
from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import TickFacts


@compiled
def target_is_old(facts: TickFacts) -> bool:
    """Detect a target taught before the camera was moved."""
    return facts.target_time < facts.progress.camera_moved_at


@compiled
def joint_1_blocks_the_path(facts: TickFacts) -> bool:
    """Detect that the limit of joint 1 blocks the path; `blocked_joint` counts from 0."""
    return facts.exploration_state.is_done and facts.progress.blocked_joint == 0


@compiled
def joint_2_blocks_the_path(facts: TickFacts) -> bool:
    """Detect that the limit of joint 2 blocks the path."""
    return facts.exploration_state.is_done and facts.progress.blocked_joint == 1


@compiled
def joint_3_blocks_the_path(facts: TickFacts) -> bool:
    """Detect that the limit of joint 3 blocks the path."""
    return facts.exploration_state.is_done and facts.progress.blocked_joint == 2


@compiled
def target_is_unchecked(facts: TickFacts) -> bool:
    """Detect a target without joints, unless the comparison of pixels and joints is off."""
    return facts.exploration_state.is_done and facts.progress.is_unchecked


@compiled
def target_is_implausible(facts: TickFacts) -> bool:
    """Detect a target whose pixels are not where the camera shows its joints."""
    exploration = facts.exploration_state
    return facts.progress.is_implausible and (exploration.is_done or exploration.is_conclusive)


@compiled
def joints_contradict_image(facts: TickFacts) -> bool:
    """Detect that the image has shown the tool at the target too long while the joints disagree."""
    since_ns, limit_s = facts.progress.mismatch_since, facts.thresholds.target_mismatch_time
    is_too_long = since_ns != NEVER_NS and facts.observation.now - since_ns > limit_s * 1e9
    return facts.exploration_state.is_done and is_too_long


@compiled
def progress_stalled(facts: TickFacts) -> bool:
    """Detect a feature error that no longer decreases."""
    thresholds, progress = facts.thresholds, facts.progress
    timeout_s = max(thresholds.stall_time, thresholds.stall_time_constants / facts.gain)
    is_late = facts.observation.now - progress.reference_time > timeout_s * 1e9
    is_far = progress.reference_error > thresholds.stall_error
    return facts.exploration_state.is_done and is_far and is_late
