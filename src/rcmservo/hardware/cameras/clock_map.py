"""What a camera's own times are on the computer's clock.

A camera stamps its frames by a clock of its own, which began at any time and runs a little fast or
slow. A frame never arrives early: the lateness of arrivals against stamps lies above a straight
line, which the least delayed frames touch, and whose slope is the drift. Of all lines below the
lateness of the last seconds the one is taken that lies closest to all of it: an edge of their lower
convex hull.

Reference: L. Zhang, Z. Liu, C. H. Xia: Clock synchronization algorithms for network measurements,
INFOCOM 2002. How far off the line may be is our own estimate: if delays vary by m s on average, the
least of n frames is hardly ever more than a few m/n s above what is possible. Where all frames of
the last seconds were delayed alike, no computer can tell.
"""

from collections import deque
from itertools import pairwise

WINDOW = 10.0
"""s of frames that are looked at."""
TIDY = 1.0
"""s after which those that are older are left out, all at once."""
MOST_DRIFT = 500e-6
"""By how much the camera's clock may run fast or slow: crystals keep a fifth of that."""
MARGIN = 160.0
"""Of the mean delay, over the number of frames: how sure the uncertainty is."""
UNKNOWN = 0.2
"""s, the same for what nobody knows yet of the delays."""
EARLY = 0.001
"""s beyond the uncertainty by which no frame is early, unless the camera's clock was set."""
LATE = 1.0
"""s by which a frame is late only where the camera's clock was set or stood still."""

Point = tuple[float, float]


class ClockMap:
    """Learns from frame after frame. A clock that jumps begins anew."""

    uncertainty: float
    """s, how far off the last answer may be."""

    def __init__(self) -> None:
        self._newest, self._told = 0, 0
        self._begin(0, 0)

    def take(self, stamp: int, arrival: int) -> int:
        """The next frame's stamp (ns on the camera's clock) and arrival (ns on the computer's);
        when it would have arrived if nothing had delayed it. A frame that comes again tells
        nothing."""
        if self._points and stamp == self._newest:
            return self._told
        self._newest = stamp
        if not self._goes_on(stamp, arrival):
            self._begin(stamp, arrival)
        x, y = self._point(stamp, arrival)
        self._keep(x, y)
        slope, height = self._line = self._lowest()
        count = len(self._points)
        delay = (self._sums[1] - slope * self._sums[0]) / count - height
        self.uncertainty = (MARGIN * delay + UNKNOWN) / count
        self._told = arrival - round((y - height - slope * x) * 1e9)
        return self._told

    def _begin(self, stamp: int, arrival: int) -> None:
        """Know nothing of the clock."""
        self._origin = stamp, arrival
        self._points: deque[Point] = deque()
        self._hull: list[Point] = []
        self._sums, self._line = [0.0, 0.0], (0.0, 0.0)
        self.uncertainty = float("inf")

    def _point(self, stamp: int, arrival: int) -> Point:
        """Stamp and lateness since the beginning, s."""
        passed = stamp - self._origin[0]
        return passed * 1e-9, (arrival - self._origin[1] - passed) * 1e-9

    def _goes_on(self, stamp: int, arrival: int) -> bool:
        """Whether the camera's clock runs on as it did."""
        if not self._points:
            return False
        x, y = self._point(stamp, arrival)
        slope, height = self._line
        late = y - height - slope * x
        return x > self._points[-1][0] and -self.uncertainty - EARLY <= late <= LATE

    def _keep(self, x: float, y: float) -> None:
        self._points.append((x, y))
        self._sums[0] += x
        self._sums[1] += y
        _extend(self._hull, (x, y))
        if self._points[0][0] < x - WINDOW - TIDY:
            self._tidy(x - WINDOW)

    def _tidy(self, since: float) -> None:
        while self._points[0][0] < since:
            self._points.popleft()
        self._hull = []
        for point in self._points:
            _extend(self._hull, point)
        self._sums = [sum(point[i] for point in self._points) for i in (0, 1)]

    def _lowest(self) -> Point:
        """Slope and height of the line below all points that lies closest to them."""
        hull, middle, slope = self._hull, self._sums[0] / len(self._points), 0.0
        for (x, y), (after, then) in pairwise(hull):
            slope = (then - y) / (after - x)
            if after >= middle:
                break
        slope = min(max(slope, -MOST_DRIFT), MOST_DRIFT)
        return slope, min(y - slope * x for x, y in hull)


def _extend(hull: list[Point], new: Point) -> None:
    """Take a point, to the right of all, into a lower convex hull."""
    while len(hull) > 1 and _above(hull[-2], hull[-1], new):
        hull.pop()
    hull.append(new)


def _above(one: Point, between: Point, other: Point) -> bool:
    """Whether a point lies on or above the straight line from one to the other."""
    rise = (other[1] - one[1]) * (between[0] - one[0])
    return (between[1] - one[1]) * (other[0] - one[0]) >= rise
