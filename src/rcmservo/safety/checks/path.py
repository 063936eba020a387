"""Detectors of what keeps the tool from the target: joint limits, an old target, a stall."""

from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import TickFacts


@compiled
def target_is_old(facts: TickFacts) -> bool:
    """Detect a target taught before the camera was moved."""
    return facts.target_time < facts.progress.camera_moved_at


@compiled
def joint_1_blocks_the_path(facts: TickFacts) -> bool:
    """Detect that the limit of joint 1 blocks the path."""
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
def joints_contradict_image(facts: TickFacts) -> bool:
    """Detect that the image shows the tool at the target for some time but the joints disagree."""
    since, limit = facts.progress.mismatch_since, facts.thresholds.target_mismatch_time
    return (
        facts.exploration_state.is_done
        and since >= 0
        and facts.observation.now - since > limit * 1e9
    )


@compiled
def progress_stalled(facts: TickFacts) -> bool:
    """Detect a feature error that no longer decreases."""
    thresholds, since = facts.thresholds, facts.progress.reference_time
    timeout = max(thresholds.stall_time, thresholds.stall_time_constants / facts.gain)
    is_late = facts.observation.now - since > timeout * 1e9
    return (
        facts.exploration_state.is_done
        and facts.progress.reference_error > thresholds.stall_error
        and is_late
    )
