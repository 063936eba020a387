"""What can be wrong at a tick, told from what the servo sees: pure checks, each one a line of the
table of faults.

Every check is written so that NaN trips it. What must be compared over time is kept in a `Watch`. A
set of causes is a number in which every cause has a bit.
"""

from rcmservo.compiled import compiled
from rcmservo.guard.causes import Cause
from rcmservo.guard.plausible import lost
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Watch
from rcmservo.interfaces import Dropped, ObservationStruct
from rcmservo.loops import all_finite
from rcmservo.method.kinematics import Rcm, reachable

JOINTS_NOT_FINITE, DRIVE_OFF = Cause.JOINTS_NOT_FINITE.bit, Cause.DRIVE_OFF.bit
ARM_SILENT, BEYOND_LIMIT = Cause.ARM_SILENT.bit, Cause.BEYOND_LIMIT.bit
NOT_FOLLOWING, CREEPS = Cause.NOT_FOLLOWING.bit, Cause.CREEPS.bit
CLOCK_STOOD = Cause.CLOCK_STOOD.bit
OVERRUN, LATE_TICK, NOT_RECORDED = Cause.OVERRUN.bit, Cause.LATE_TICK.bit, Cause.NOT_RECORDED.bit
FRAMES_CLOCK = Cause.FRAMES_CLOCK.bit
FRAMES_NOT_NEW, JOINTS_UNKNOWN = Cause.FRAMES_NOT_NEW.bit, Cause.JOINTS_UNKNOWN.bit
LATE, AGEING, REJECTED = Cause.LATE.bit, Cause.AGEING.bit, Cause.REJECTED.bit
SWAPPED, CAMERA_MOVED = Cause.SWAPPED.bit, Cause.CAMERA_MOVED.bit
SURPRISED = Cause.SURPRISED.bit
LOST = (0, Cause.MARKER_1_LOST.bit, Cause.MARKER_2_LOST.bit, Cause.MARKERS_LOST.bit)
"""By which markers are lost: none, 1, 2, both."""

WITHOUT = (0, Cause.WITHOUT_MARKER_1.bit, Cause.WITHOUT_MARKER_2.bit, Cause.MARKERS_LOST.bit)
"""The same where the other marker suffices."""

DROPPED_CAUSES = {
    Dropped.NONE: Cause.STALE,
    Dropped.NOT_NEW: Cause.FRAMES_NOT_NEW,
    Dropped.CLOCK: Cause.FRAMES_CLOCK,
    Dropped.DAMAGED: Cause.FRAMES_DAMAGED,
}
"""Why no new frame has come, by why the frame offered last was not used."""

DROPPED = tuple(DROPPED_CAUSES[kind].bit for kind in Dropped)


@compiled
def arm_faults(w: Watch, seen: ObservationStruct, on: bool, rcm: Rcm, t: Thresholds) -> int:
    """What is wrong with the arm; `on`, whether its drive should be."""
    if not all_finite(seen.q):
        return JOINTS_NOT_FINITE
    found = 0
    if on and not seen.enabled:
        found |= DRIVE_OFF
    if not abs(seen.now - seen.q_time) <= t.silence * 1e9:
        found |= ARM_SILENT
    if not reachable(rcm, seen.q, t.slack):
        found |= BEYOND_LIMIT
    for i in range(3):
        if not abs(seen.q[i] - w.reached[i]) <= t.following[i]:
            found |= NOT_FOLLOWING
        if all_finite(w.rest) and not abs(seen.q[i] - w.rest[i]) <= t.following[i]:
            found |= CREEPS
    return found


@compiled
def loop_faults(w: Watch, seen: ObservationStruct, period: int, t: Thresholds) -> int:
    """What is wrong with the loop and its record."""
    found = 0 if seen.recorded else NOT_RECORDED
    if not w.gap > 0:
        found |= CLOCK_STOOD
    if w.late >= t.late_ticks or not w.gap - period <= t.overrun * 1e9:
        found |= OVERRUN
    elif w.late > 0:
        found |= LATE_TICK
    return found


@compiled
def camera_faults(w: Watch, seen: ObservationStruct, rcm: Rcm, t: Thresholds) -> int:
    """What is wrong with the frames and with where they show the markers."""
    found = FRAMES_NOT_NEW if seen.frame < w.frame else 0
    if seen.frame < 0:
        return found
    first, second = lost(seen.points)
    which = (1 if first else 0) + (2 if second else 0)
    found |= WITHOUT[which] if w.spared else LOST[which]
    if not reachable(rcm, seen.q_exposure, t.slack):
        found |= JOINTS_UNKNOWN
    if not w.latency <= t.latency * 1e9:
        found |= LATE
    period = w.period if w.period != 0.0 else 1e9 * t.first_period
    age = (seen.now - seen.arrival) / period
    if not age <= t.stale_hold:
        coming = (seen.now - w.taken) / period <= t.stale_slow
        found |= FRAMES_CLOCK if coming else DROPPED[seen.dropped]
    elif not age <= t.stale_slow:
        found |= AGEING
    if w.rejected > 0:
        found |= unbelieved(w, t)
    return found


@compiled
def unbelieved(w: Watch, t: Thresholds) -> int:
    """What it means that frames are not believed."""
    if w.rejected < t.rejected:
        return REJECTED
    if w.swapped >= t.rejected:
        return SWAPPED
    moved = w.jumped >= t.rejected or w.rejected >= t.rejected_for_good
    return CAMERA_MOVED if moved else SURPRISED
