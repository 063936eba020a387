"""Recorded frames through tracking, features, imaged RCM and the estimators, and a score for each.

The score is one-step prediction. From everything up to frame t each estimator predicts y at t + 1,
given only where the joints then were, and the errors' root mean square is set beside that of
predicting no motion at all. An estimator with a projection model predicts ŷ(t+1) = y(t) + h(p(t+1))
− h(p(t)); every one predicts linearly, Ĵ Δp.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.config.rig_file import Lab
from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Explains, Floats, Markers, Tracker
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.features import about, difference, features
from rcmservo.method.imaged_rcm import ImagedRcm, remember, solve
from rcmservo.method.tool import Tool
from rcmservo.offline.frames_folder import Pose, frames, load
from rcmservo.tracking import PointMarkers

FIRST = 9
"""Index of the first frame from which a step is predicted: the tenth."""

ENOUGH = FIRST + 2
"""Frames with both markers from which one step at least can be predicted."""

STILL_SPEED = 10.0
"""mm/s at which the tool is taken to have gone from one still to the next, where a recording has no
times."""


@dataclass(frozen=True, eq=False)
class Replay:
    """What a recording gave."""

    poses: list[Pose]
    """All rows of the recording, in their order."""
    markers: list[Markers]
    """Those of every frame."""
    o_c: Floats
    """The imaged RCM (2,) px, NaN where it was not observable."""
    condition: float
    """Condition number of (16), however large; infinite where (16) is singular."""
    reprojection: Floats
    """(2,) px: the root mean square of each marker's 2-D error under the final fit."""
    one_step: dict[str, Floats]
    """By name, (3,) rad, px, px: NaN where no step could be predicted."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """A frame in which both markers were found."""

    p1: Floats
    points: Floats
    dt: float
    sizes: Floats


def replay(
    folder: Path,
    lab: Lab,
    tracker: Tracker,
    estimators: dict[str, Estimator],
    imaged_rcm: ImagedRcm,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Replay:
    """Score a recording. `estimators` by name; the first one with a projection model gives the
    reprojection. A recording of points needs no `tracker`."""
    poses = load(folder, lab.mechanism, lab.tool)
    if poses and poses[0].points is not None:
        tracker = PointMarkers()
    markers: list[Markers] = []
    for frame in frames(poses):
        markers.append(tracker.find(frame))
        progress(len(markers), len(poses))
    seen = _found(poses, markers)
    if len(seen) < ENOUGH:
        raise UnusableFile(folder, _too_few(len(seen), poses, markers, tracker))
    origins = _origins(seen, imaged_rcm)
    one_step = {"no_motion": _no_motion(seen, origins)}
    reprojection = np.full(2, np.nan)
    for name, estimator in estimators.items():
        finite, linear, memory = _score(estimator, lab.tool, seen, origins)
        if finite is not None:
            one_step[name] = finite
        one_step[f"{name}_linear"] = linear
        if finite is not None and np.isnan(reprojection).any():
            reprojection = _reprojection(estimator, memory, lab.tool, seen, origins[-1][0])
    o_c, condition = origins[-1]
    return Replay(poses, markers, o_c, condition, reprojection, one_step)


def _found(poses: list[Pose], markers: list[Markers]) -> list[_Seen]:
    seen: list[_Seen] = []
    before: Pose | None = None
    for pose, found in zip(poses, markers, strict=True):
        if np.isfinite(found.points).all():
            seen.append(_Seen(pose.p1, found.points, _since(before, pose), found.radius))
            before = pose
    return seen


def _too_few(count: int, poses: list[Pose], markers: list[Markers], tracker: Tracker) -> str:
    """How many frames show both markers, and why the first of the others does not."""
    how_many = f"only {count} show both markers" if count else "no frame shows both markers"
    words = f"{len(poses)} frames, {how_many}, and a score takes {ENOUGH}"
    for frame, pose, found in zip(frames(poses), poses, markers, strict=True):
        if not np.isfinite(found.points).all():
            why = tracker.why(frame) if isinstance(tracker, Explains) else ""
            return f"{words} (frame {pose.name}: {why})" if why else words
    return words


def _since(before: Pose | None, pose: Pose) -> float:
    """Seconds between two poses: as recorded, or as long as the way takes at STILL_SPEED."""
    if before is None:
        return 0.0
    if before.time is not None and pose.time is not None:
        return max(pose.time - before.time, 0.0)
    return float(np.linalg.norm(pose.p1 - before.p1)) / STILL_SPEED


def _origins(seen: list[_Seen], imaged_rcm: ImagedRcm) -> list[tuple[Floats, float]]:
    """o_c (2,) and its condition as known after each frame; NaN while it is not observable."""
    (lines, count), printed = imaged_rcm.init(), imaged_rcm.printed
    origins: list[tuple[Floats, float]] = []
    for one in seen:
        lines, count = remember(lines, count, one.points, printed)
        o_c, condition = solve(lines, count, imaged_rcm.refinements, printed)
        known = condition <= imaged_rcm.max_condition
        origins.append((o_c, condition) if known else (np.full(2, np.nan), condition))
    return origins


def _no_motion(seen: list[_Seen], origins: list[tuple[Floats, float]]) -> Floats:
    steps = [t for t in range(FIRST, len(seen) - 1) if np.isfinite(origins[t][0]).all()]
    return _rms([_change(seen[t], seen[t + 1], origins[t][0]) for t in steps])


def _score(
    estimator: Estimator, tool: Tool, seen: list[_Seen], origins: list[tuple[Floats, float]]
) -> tuple[Floats | None, Floats, Any]:
    """Errors over the finite step (None without a projection model) and of the linear step, and the
    last memory."""
    memory = estimator.init()
    finite: list[Floats] = []
    linear: list[Floats] = []
    since_learnt: float | None = None
    for t, (one, (o_c, _)) in enumerate(zip(seen, origins, strict=True)):
        since_learnt = None if since_learnt is None else since_learnt + one.dt
        if not np.isfinite(o_c).all():
            continue
        sample = Sample(one.p1, one.points, o_c, since_learnt or 0.0, one.sizes)
        memory, since_learnt = estimator.update(memory, tool, sample), 0.0
        if t < FIRST or t + 1 == len(seen):
            continue
        after = seen[t + 1]
        change = _change(one, after, o_c)
        linear.append(
            difference(change, estimator.jacobian(memory, tool, sample) @ (after.p1 - one.p1))
        )
        here, there = (estimator.predict(memory, tool, p1) for p1 in (one.p1, after.p1))
        if here is not None and there is not None:
            finite.append(difference(change, difference(features(there), features(here))))
    return (_rms(finite) if estimator.models else None), _rms(linear), memory


def _change(one: _Seen, after: _Seen, o_c: Floats) -> Floats:
    """Δy (3,) from one frame to the next, about the same origin."""
    return difference(features(about(after.points, o_c)), features(about(one.points, o_c)))


def _rms(errors: list[Floats]) -> Floats:
    return np.sqrt(np.mean(np.array(errors) ** 2, axis=0)) if errors else np.full(3, np.nan)


def _reprojection(
    estimator: Estimator, memory: Any, tool: Tool, seen: list[_Seen], o_c: Floats
) -> Floats:
    """Root mean square (2,) px of the length of each marker's error under one fit, over all
    frames."""
    squares: list[Floats] = []
    for one in seen:
        model = estimator.predict(memory, tool, one.p1)
        assert model is not None
        squares.append(np.sum((model - about(one.points, o_c)).reshape(2, 2) ** 2, axis=1))
    return np.sqrt(np.mean(squares, axis=0))
