"""Conversion of a camera's time stamps to the computer's clock.

A camera stamps its frames with its own clock, which has an arbitrary origin and a small drift. A
frame never arrives early, so the differences of arrivals and stamps lie above a straight line. The
least delayed frames touch this line, and its slope is the drift. The estimate is the line below all
differences of the last seconds that lies closest to them: an edge of their lower convex hull.

Reference: L. Zhang, Z. Liu, C. H. Xia: Clock synchronization algorithms for network measurements,
INFOCOM 2002. The uncertainty is this project's own estimate: if delays vary by m s on average, the
smallest of n delays rarely exceeds the smallest possible one by more than a few m/n s. A delay
common to all frames of the last seconds cannot be detected.
"""

from collections import deque
from itertools import pairwise

WINDOW_S = 10.0
"""Duration of the frames that determine the line."""
WINDOW_OVERRUN_S = 1.0
"""Time beyond the window after which all older frames are removed together."""
MAX_DRIFT = 500e-6
"""Largest relative drift of the camera's clock. Crystals stay within a fifth of it."""
DELAY_MARGIN, INITIAL_UNCERTAINTY_S = 160.0, 0.2
"""Coefficients of the uncertainty: (``DELAY_MARGIN`` mean delay + ``INITIAL_UNCERTAINTY_S``) /
number of frames. The second one covers delays that have not occurred yet."""
MAX_EARLINESS_S = 0.001
"""Earliness beyond the uncertainty that shows that the camera's clock was set."""
MAX_LATENESS_S = 1.0
"""Lateness that shows that the camera's clock was set or stopped."""

Point = tuple[float, float]
"""Stamp of a frame and its lateness (arrival minus stamp), each relative to an origin, s."""


class ClockMap:
    """Estimate of a camera's clock, updated with each frame. A jump of the clock restarts it."""

    uncertainty: float
    """Largest error of the last result in s."""

    def __init__(self) -> None:
        self._newest_stamp, self._result = 0, 0
        self._restart(0, 0)

    def undelayed_arrival(self, stamp: int, arrival: int) -> int:
        """Return the time at which a frame would have arrived without a delay.

        A repeated stamp changes nothing and returns the last result.

        Parameters
        ----------
        stamp : int
            Time stamp of the frame, ns on the camera's clock.
        arrival : int
            Arrival of the frame, ns on the computer's clock.

        Returns
        -------
        int
            Time in ns on the computer's clock.
        """
        if self._points and stamp == self._newest_stamp:
            return self._result
        self._newest_stamp = stamp
        if not self._is_continuous(stamp, arrival):
            self._restart(stamp, arrival)
        stamp_s, lateness_s = point = self._to_point(stamp, arrival)
        self._add_point(point)
        slope, height = self._line = self._fit_line()
        frame_count = len(self._points)
        mean_delay_s = (self._sums[1] - slope * self._sums[0]) / frame_count - height
        self.uncertainty = (DELAY_MARGIN * mean_delay_s + INITIAL_UNCERTAINTY_S) / frame_count
        self._result = arrival - round((lateness_s - height - slope * stamp_s) * 1e9)
        return self._result

    def _restart(self, stamp: int, arrival: int) -> None:
        """Discard all frames and take the origins of both clocks from a frame."""
        self._origin = stamp, arrival
        self._points: deque[Point] = deque()
        self._hull: list[Point] = []
        self._sums = [0.0, 0.0]
        """Sums of the points' two coordinates."""
        self._line = 0.0, 0.0
        """Slope of the line, and its lateness (s) at the origin."""
        self.uncertainty = float("inf")

    def _to_point(self, stamp: int, arrival: int) -> Point:
        elapsed = stamp - self._origin[0]
        return elapsed * 1e-9, (arrival - self._origin[1] - elapsed) * 1e-9

    def _is_continuous(self, stamp: int, arrival: int) -> bool:
        """Return True if the frame agrees with the present line."""
        if not self._points:
            return False
        stamp_s, lateness_s = self._to_point(stamp, arrival)
        slope, height = self._line
        delay_s = lateness_s - height - slope * stamp_s
        is_newer = stamp_s > self._points[-1][0]
        return is_newer and -self.uncertainty - MAX_EARLINESS_S <= delay_s <= MAX_LATENESS_S

    def _add_point(self, point: Point) -> None:
        stamp_s, lateness_s = point
        self._points.append(point)
        self._sums[0] += stamp_s
        self._sums[1] += lateness_s
        _extend_hull(self._hull, point)
        if self._points[0][0] < stamp_s - WINDOW_S - WINDOW_OVERRUN_S:
            self._remove_before(stamp_s - WINDOW_S)

    def _remove_before(self, start_s: float) -> None:
        while self._points[0][0] < start_s:
            self._points.popleft()
        self._hull = []
        for point in self._points:
            _extend_hull(self._hull, point)
        self._sums = [sum(point[i] for point in self._points) for i in (0, 1)]

    def _fit_line(self) -> Point:
        """Return slope and height of the closest line below all points."""
        hull, mean_stamp_s, slope = self._hull, self._sums[0] / len(self._points), 0.0
        for (x, y), (next_x, next_y) in pairwise(hull):
            slope = (next_y - y) / (next_x - x)
            if next_x >= mean_stamp_s:  # the closest line touches the hull at the mean stamp
                break
        slope = min(max(slope, -MAX_DRIFT), MAX_DRIFT)
        return slope, min(y - slope * x for x, y in hull)


def _extend_hull(hull: list[Point], new: Point) -> None:
    """Add a point to the right of all others to a lower convex hull."""
    while len(hull) > 1 and _is_above(hull[-2], hull[-1], new):
        hull.pop()
    hull.append(new)


def _is_above(left: Point, middle: Point, right: Point) -> bool:
    """Return True if the middle point lies on or above the line through the other two."""
    rise = (right[1] - left[1]) * (middle[0] - left[0])
    return (middle[1] - left[1]) * (right[0] - left[0]) >= rise
