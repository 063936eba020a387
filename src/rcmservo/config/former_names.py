"""Former names of settings and options, from before they were renamed.

Records, targets and studies of earlier versions contain former names and are still read. A command
line or a rig file that contains a former name is refused; the message gives the present name.
"""

from collections.abc import Iterable, Mapping
from typing import Any

FORMER_SETTINGS = {
    "leg": "leg_time",
    "share": "speed_scale",
    "reach": "max_leg_length",
    "legs": "min_corners",
    "spread": "initial_std",
    "answer_within": "reply_timeout",
    "patience": "command_timeout",
    "lead": "max_lead",
    "look": "appearance",
    "shown": "teaching_frames",
    "own": "user_estimator",
    "film": "video",
    "stale_slow": "max_frame_age_slow",
    "stale_hold": "max_frame_age_hold",
    "first_period": "initial_frame_period",
    "latency": "max_latency",
    "silence": "arm_timeout",
    "following": "max_following_error",
    "forget": "following_error_decay",
    "come_to_rest": "settling_time",
    "slack": "limit_tolerance",
    "overrun": "max_tick_delay",
    "late_share": "late_tick_fraction",
    "late_ticks": "max_late_ticks",
    "innovation": "max_innovation",
    "mistimed": "timing_error_fraction",
    "left_over": "max_residual_px",
    "nearest_camera": "min_camera_distance",
    "drift": "max_drift_sigma",
    "drift_px": "max_drift_px",
    "stuck": "frozen_image_motion",
    "stuck_px": "stuck_marker_px",
    "elsewhere": "max_target_mismatch",
    "elsewhere_time": "target_mismatch_time",
    "without_marker": "max_single_marker_deviation",
    "jump": "max_jump_px",
    "nearest": "max_px_per_mm",
    "comparable": "max_compared_motion",
    "agreement": "jump_agreement",
    "rejected": "max_rejected_frames",
    "rejected_for_good": "moved_camera_frames",
    "telling": "min_predicted_change",  # codespell:ignore telling
    "wrong": "max_change_error",
    "disagreements": "max_contradictions",
    "closed": "singular_fraction",
    "nearly_closed": "nearly_singular_fraction",
    "small_error": "min_checked_error",
    "least_room": "min_exploration_room",
    "largest": "max_jacobian_entry",
    "good_to_recover": "frames_to_recover",
    "good_to_servo": "frames_to_servo",
    "limit_share": "limit_speed_fraction",
    "stall_fall": "stall_decrease",
    "stall_share": "stall_decrease_fraction",
    "stall_gains": "stall_time_constants",
}
"""Present name of each setting by its former one."""


def find_present_name(name: str, names: Iterable[str]) -> str:
    """Return the present name of a former setting; empty if it is not one of `names`."""
    present = FORMER_SETTINGS.get(name, "")
    return present if present in names else ""


def replace_former_names(table: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Return a table of an earlier version in which former names are replaced by those in `names`.

    A key that is already one of `names`, or that has no present name, stays as it is.
    """
    present_names = set(names)
    return {
        name if name in present_names else find_present_name(name, present_names) or name: value
        for name, value in table.items()
    }
