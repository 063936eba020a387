"""What the checks for faults must remember from tick to tick: arm, loop, camera, markers, estimate.

A new frame is compared with the motion since the last one, and the joints with the commands before.
"""

import numpy as np

from rcmservo.interfaces import Floats, Observation, ObservationStruct
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, length, minus, put
from rcmservo.numerics.structs import Row, Struct, flag, part, real, reals, whole
from rcmservo.safety.innovation import judged, leapt
from rcmservo.safety.thresholds import Thresholds

STILL = np.zeros(3)
UNKNOWN = np.full(3, np.nan)


class ObservationRow(Struct, source=Observation, without=("sizes", "quality")):
    """Observation in the state. A row is passed on without counting who refers to it."""


class Watch(Row):
    """What the checks remember."""

    observation: ObservationRow = part(ObservationRow, "the observation of this tick")
    reached: Floats = reals(3, "rad, rad, mm", "where its commands should have brought the arm")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "the joints' rates, lagging behind the commands")
    told: int = whole("ns", "when the arm told its joints last")
    idle: int = whole("ns", "since when nothing is commanded, -1 while something is")
    rest: Floats = reals(3, "rad, rad, mm", "where the joints came to rest since, NaN before")
    late: int = whole("", "ticks that came late in a row")
    gap: int = whole("ns", "between the last two ticks")
    frame: int = whole("", "the newest frame seen, -1 before the first")
    believed: int = whole("", "the newest frame accepted, -1 before the first")
    exposure: int = whole("ns", "of the newest frame seen")
    taken: int = whole("ns", "the tick at which it was first seen")
    period: float = real("ns", "between frames, 0 while unknown")
    latency: int = whole("ns", "from the newest frame's exposure to its tick")
    spared: bool = flag("whether one marker is lost there, and the other and the joints suffice")
    rejected: int = whole("", "frames in a row that were not believed")
    jumped: int = whole("", "of these, those in which both markers jumped")
    swapped: int = whole("", "of these, those with each marker near the other's place")
    elsewhere: Floats = reals((2, 2), "px", "where the newest rejected frame showed the markers")
    left: Floats = reals((2, 2), "px", "mean of what the fit leaves over of the markers lately")
    averaged: int = whole("", "frames that it is the mean of")
    off: Floats = reals(2, "px", "how far off each marker is by that, 0 where noise explains it")
    seen: Floats = reals((2, 2), "px", "the newest markers that were not those before")
    foretold: Floats = reals((2, 2), "px", "where the fit had them then")
    expected: Floats = reals((2, 2), "px", "where the fit has the newest ones")
    frozen: bool = flag("whether the same markers are seen since, though the tool moved")
    stood: Floats = reals(3, "mm", "p₁ when the markers seen before these were seen first")
    anchors: Floats = reals((2, 4), "px", "where each marker stands since, and the other did then")
    p1: Floats = reals(3, "mm", "marker 1 when the estimate was judged last")
    points: Floats = reals((2, 2), "px", "the markers then")
    wrong: int = whole("", "judgements in a row against the estimate")


def begin() -> Watch:
    """Nothing seen yet."""
    unknown = dict.fromkeys(("reached", "rest", "elsewhere", "p1", "points", "seen"), np.nan)
    return Watch.of(idle=-1, frame=-1, believed=-1, **unknown)


@compiled
def unwatch(w: Watch, markers: bool) -> None:
    """The counts of the same arm and camera begin anew; if asked for, those of the `markers` too,
    and no frame is believed.
    """
    w.late, w.wrong, w.averaged, w.frozen = 0, 0, 0, False
    put(w.off, STILL[:2])
    put(w.p1, UNKNOWN)
    if markers:
        w.rejected, w.jumped, w.swapped, w.believed, w.spared = 0, 0, 0, -1, False


@compiled
def followed(
    reached: Floats, rates: Floats, applied: Floats, q: Floats, dt: float, lag: float, forget: float
) -> None:
    """Write where the joints should be dt s later, and their lagging rates, by the rates that the
    arm took, over the same of now.
    """
    left, pulled = np.exp(-dt / lag), min(dt / forget, 1.0)
    for i in range(3):
        lead = rates[i] - applied[i]
        there = reached[i] + applied[i] * dt + lead * lag * (1.0 - left)
        reached[i] = there + (q[i] - there) * pulled
        rates[i] = applied[i] + lead * left


@compiled
def watch_loop(w: Watch, gap: int, period: int, lag: float, t: Thresholds) -> None:
    """One more tick, `gap` ns after the last: how late it came, where the joints should be with
    drives that lag by so many s, and where they rest.
    """
    seen, w.gap = w.observation, gap
    w.late = w.late + 1 if gap > (1.0 + t.late_share) * period else 0
    if seen.enabled and all_finite(w.reached):
        dt = max(seen.q_time - w.told, 0) * 1e-9
        followed(w.reached, w.rates, seen.applied, seen.q, dt, lag, t.forget)
    else:
        put(w.reached, seen.q)
        put(w.rates, STILL)
    watch_rest(w, seen, t)
    w.told = seen.q_time


@compiled
def store_observation(row: ObservationRow, seen: ObservationStruct) -> None:
    """Copy the observation into a row."""
    row.now, row.q_time, row.enabled = seen.now, seen.q_time, seen.enabled
    row.frame, row.exposure, row.arrival = seen.frame, seen.exposure, seen.arrival
    row.dropped, row.recorded = seen.dropped, seen.recorded
    put(row.q, seen.q)
    put(row.applied, seen.applied)
    put(row.q_exposure, seen.q_exposure)
    put(row.points, seen.points)


@compiled
def watch_rest(w: Watch, seen: ObservationRow, t: Thresholds) -> None:
    """Where the joints came to rest, if nothing has been commanded since."""
    if not (seen.enabled and length(seen.applied) == 0.0):
        w.idle = -1
        put(w.rest, UNKNOWN)
    elif w.idle < 0:
        w.idle = seen.now
    elif not all_finite(w.rest) and seen.now - w.idle >= t.come_to_rest * 1e9:
        put(w.rest, seen.q)


@compiled
def watch_frame(w: Watch, seen: ObservationRow, t: Thresholds) -> None:
    """A new frame: its latency, and the period between frames, which no gap may stretch at once."""
    if w.frame >= 0:
        one = (seen.exposure - w.exposure) / (seen.frame - w.frame)
        one = min(one, t.stale_slow * w.period if w.period != 0.0 else 1e9 * t.first_period)
        w.period = w.period + 0.2 * (one - w.period) if w.period != 0.0 else one
    w.frame, w.exposure, w.taken = seen.frame, seen.exposure, seen.now
    w.latency = seen.now - seen.exposure


@compiled
def stays(w: Watch, points: Floats, t: Thresholds) -> bool:
    """Whether the markers are still where the frame before was rejected for showing them."""
    first, second, _ = leapt(points, w.elsewhere, 0.0, t.agreement * t.jump, t.nearest)
    return w.rejected > 0 and not (first or second)


@compiled
def watch_markers(
    w: Watch, first: bool, second: bool, crossed: bool, points: Floats, t: Thresholds
) -> None:
    """One more frame in which the first, the second marker is out of place, or each in the other's.

    Both have jumped for good only if their new places agree from frame to frame: nonsense does not.
    """
    if not (first or second):
        w.rejected, w.jumped, w.swapped = 0, 0, 0
        return
    both = first and second
    steady = w.rejected == 0 or stays(w, points, t)
    w.rejected += 1
    w.jumped = w.jumped + 1 if both and steady else (1 if both else 0)
    w.swapped = w.swapped + 1 if both and crossed else 0
    put(w.elsewhere, points)


@compiled
def watch_estimate(
    w: Watch, p1: Floats, points: Floats, o_c: Floats, J_hat: Floats, t: Thresholds
) -> None:
    """The estimate is judged by what the motion since it was judged last has changed."""
    if all_finite(w.p1):
        verdict = judged(points, w.points, o_c, J_hat, minus(p1, w.p1), t.telling, t.wrong)
        if verdict < 0:
            return
        w.wrong = w.wrong + 1 if verdict == 1 else 0
    put(w.p1, p1)
    put(w.points, points)
