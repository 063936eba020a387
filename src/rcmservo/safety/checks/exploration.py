"""Detectors of an exploration that cannot begin or does not succeed."""

from rcmservo.control.exploration import overdue
from rcmservo.estimation.projection_prediction import order
from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import DetailFacts, TickFacts

REVERSED = -0.3
"""Order of the markers below which they are taken for each other."""


@compiled
def there_is_no_room(c: TickFacts) -> bool:
    """Detect joint limits that leave no room."""
    return not c.tour.done and c.tour.no_room


@compiled
def exploration_failed(c: TickFacts) -> bool:
    """Detect an exploration that takes too long, though room and picture allow it."""
    hindered = c.tour.done or c.tour.no_room or c.watch.frozen
    return not hindered and overdue(c.tour, c.seen.now, c.exploration)


@compiled
def markers_stand_in_reverse(c: TickFacts) -> bool:
    """Return True if an exploration failed since the markers are taken for each other."""
    return exploration_failed(c) and order(c.prospect) < REVERSED


def advise(f: DetailFacts) -> str:
    """Return the advice of the estimator."""
    return f.advice
