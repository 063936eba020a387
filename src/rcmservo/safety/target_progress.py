"""Progress towards the target: the part of the control state that the checks read."""

from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import Row, flag, real, reals, whole


class TargetProgress(Row):
    """Progress of the tool towards the target.

    The control law inverts the estimated Jacobian with damping, eq. (31). Near a singular surface
    it therefore reduces only a fraction of the error; for a small error this fraction counts as 1.
    Image and joints disagree if the image shows the tool at the target but the joints do not.
    """

    blocked_joint: int = whole("", "index of the joint whose limit blocks the path, -1 for none")
    reducible_fraction: float = real("", "fraction of the error that the damped law reduces")
    remaining_mm: float = real("mm", "distance of marker 1 from the target by the image")
    mean_step: Floats = reals(3, "mm", "mean step of marker 1 to the target by the image")
    has_arrived: bool = flag("True if the joints have reached the values of the taught target")
    pose_bound: float = real(
        "mm", "distance of marker 2 from its taught position with 95 %, NaN before arrival"
    )
    bound_parts: Floats = reals(
        3,
        "mm",
        "parts of this distance: noise of the markers, errors of arm, tool and lens, way left",
    )
    is_unchecked: bool = flag("True if the target has no joints with which to check its pixels")
    is_implausible: bool = flag(
        "True if the fit contradicts the pixels of the target at its joints"
    )
    aim: Floats = reals((2, 2), "px", "markers that the servo aims at")
    goal: Floats = reals(3, "mm", "marker 1 at the target by image and joints, NaN if unknown")
    aims_at_approach: bool = flag("True if the aim is the pose from which the target is approached")
    has_approached: bool = flag("True once the tool has reached that pose for this target")
    returns: bool = flag("True while the tool moves to the goal by the joints")
    has_returned: bool = flag("True if it has done so for this target")
    nearest_mm: float = real(
        "mm", "least distance from the joints of teaching in the motion to the target"
    )
    detour_mm: float = real("mm", "motion away from the joints of teaching since then")
    gap_since: int = whole("ns", "time since which the tool will stop elsewhere, or NEVER_NS")
    contradicted_since: int = whole(
        "ns", "time since which the image alone contradicts the joints, or NEVER_NS"
    )
    mismatch_since: int = whole("ns", "time since which image and joints disagree, or NEVER_NS")
    reference_error: float = real("", "scaled error √(2V) from which the next decrease is measured")
    reference_time: int = whole("ns", "time of `reference_error`")
    camera_moved_at: int = whole("ns", "time of the last detected camera motion, or NEVER_NS")
