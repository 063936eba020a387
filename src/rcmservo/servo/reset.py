"""What a tick writes over what was known: nothing learnt, a rule begun anew, another way to go."""

import numpy as np

from rcmservo.control.drive_lag import forget_lag
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, put
from rcmservo.servo.state import Decision, Stored


@compiled
def forget(s: Stored) -> None:
    """Nothing learnt: Ĵ = 0."""
    e, tour = s.estimate, s.tour
    fill(e.points, np.nan)
    fill(e.p1, np.nan)
    fill(e.o_c, np.nan)
    fill(e.o_c_covariance, np.nan)
    fill(e.y, np.nan)
    fill(e.delta, np.nan)
    fill(e.ahead, np.nan)
    fill(e.J_hat, 0.0)
    fill(e.law_jacobian, 0.0)
    fill(e.law_error, 0.0)
    e.exposure, e.line_count, e.rcm_condition, e.condition = -1, 0, np.inf, np.inf
    fill(tour.home, 0.0)
    fill(tour.sides, 0.0)
    fill(tour.goal, 0.0)
    forget_lag(tour)
    tour.visits, tour.start = 0, 0
    tour.begun, tour.no_room, tour.done = False, False, False


@compiled
def forget_but_places(s: Stored) -> None:
    """Nothing learnt, but for where the markers were seen last."""
    points, p1 = s.estimate.points.copy(), s.estimate.p1.copy()
    forget(s)
    put(s.estimate.points, points)
    put(s.estimate.p1, p1)


@compiled
def restart(d: Decision, now: int) -> None:
    """The rule on stalls begins anew, counted from `now` ns."""
    d.peak, d.peak_time = np.inf, now


@compiled
def stand(d: Decision) -> None:
    """Want to stand still."""
    fill(d.v, 0.0)
    fill(d.rates, 0.0)
