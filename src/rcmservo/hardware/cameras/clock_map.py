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
        x, y = self._point(stamp, arrival)
        self._add_point(x, y)
        slope, height = self._line = self._fit_line()
        count = len(self._points)
        delay = (self._sums[1] - slope * self._sums[0]) / count - height
        self.uncertainty = (DELAY_MARGIN * delay + INITIAL_UNCERTAINTY_S) / count
        self._result = arrival - round((y - height - slope * x) * 1e9)
        return self._result

    def _restart(self, stamp: int, arrival: int) -> None:
        """Discard all frames and take the origins of both clocks from a frame."""
        self._origin = stamp, arrival
        self._points: deque[Point] = deque()
        self._hull: list[Point] = []
        self._sums, self._line = [0.0, 0.0], (0.0, 0.0)
        self.uncertainty = float("inf")

    def _point(self, stamp: int, arrival: int) -> Point:
        """Return stamp and lateness in s, relative to the origin."""
        elapsed = stamp - self._origin[0]
        return elapsed * 1e-9, (arrival - self._origin[1] - elapsed) * 1e-9

    def _is_continuous(self, stamp: int, arrival: int) -> bool:
        """Return True if the frame agrees with the present line."""
        if not self._points:
            return False
        x, y = self._point(stamp, arrival)
        slope, height = self._line
        lateness = y - height - slope * x
        earliest = -self.uncertainty - MAX_EARLINESS_S
        return x > self._points[-1][0] and earliest <= lateness <= MAX_LATENESS_S

    def _add_point(self, x: float, y: float) -> None:
        self._points.append((x, y))
        self._sums[0] += x
        self._sums[1] += y
        _extend_hull(self._hull, (x, y))
        if self._points[0][0] < x - WINDOW_S - WINDOW_OVERRUN_S:
            self._remove_before(x - WINDOW_S)

    def _remove_before(self, since: float) -> None:
        while self._points[0][0] < since:
            self._points.popleft()
        self._hull = []
        for point in self._points:
            _extend_hull(self._hull, point)
        self._sums = [sum(point[i] for point in self._points) for i in (0, 1)]

    def _fit_line(self) -> Point:
        """Return slope and height of the closest line below all points."""
        hull, middle, slope = self._hull, self._sums[0] / len(self._points), 0.0
        for (x, y), (next_x, next_y) in pairwise(hull):
            slope = (next_y - y) / (next_x - x)
            if next_x >= middle:
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
