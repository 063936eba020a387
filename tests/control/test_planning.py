"""The next corner is the one that tells most of the way to the target, and what is expected of it
comes true.
"""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import SHAFT, SPACING, markers_seen, random_from, seeds, true_camera
from rcmservo.control.exploration import (
    CORNER_TOLERANCE,
    CORNERS,
    Exploration,
    Exploring,
    begin,
    box,
)
from rcmservo.control.exploration_planning import NEGLIGIBLE_ERROR_MM, directed, off_target, plan
from rcmservo.estimation.projection_fit import MIN_FRAME_SPACING_MM, Prospect, blank, see
from rcmservo.geometry.kinematics import SphericalRcm, position
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import as_row
from rcmservo.safety.gate import Gate

RCM, FASTEST, FRAMES = SphericalRcm(), np.array(Gate.speed), 8
X = as_row(Exploration())[0]
LEAST_SEEN = 0.05
"""px/mm, in the direction that is seen least; below it lies a singular surface."""


def places(corners: Floats) -> Floats:
    """Marker 1 (n, 3) mm in the frames of straight legs between these joints."""
    legs = pairwise(corners)
    q = [one + (other - one) * (k + 1) / FRAMES for one, other in legs for k in range(FRAMES)]
    return np.stack([position(RCM.rcm(), joints) for joints in [corners[0], *q]])


class Toured:
    """A tool that has been to three corners, the true camera, and a target somewhere."""

    def __init__(
        self, seed: int, noise: float = 0.0, beside: bool = False, number: int = 0
    ) -> None:
        self.random = random_from(seed)
        lower, upper = RCM.limits.arrays
        inside = self.random.uniform(0.2, 0.8, 3)
        if beside:
            inside[1:] = self.random.choice([0.021, 0.979], 2)
        self.home = lower + inside * (upper - lower)
        self.home[0] = np.clip(self.home[0], 0.5, 1.2)
        self.tour = Exploring.of()
        begin(self.tour.rows[0], RCM.rcm(), FASTEST, self.home, 0, 0.0, X)
        sides = self.tour.sides.copy()
        self.corners = self.home + np.vstack([np.zeros(3), CORNERS[:3]]) * sides
        self.tour.rows["visits"] = 4 * number
        box(self.tour.rows[0], RCM.rcm(), FASTEST, 0.0, X)
        self.tour.rows["visits"] = 3
        self.q, self.seen = self.corners[-1], places(self.corners)
        self.p1 = self.seen[-1]
        self.C = self.camera()
        self.v = self.fit(noise)
        way = self.random.standard_normal(3)
        self.there = self.p1 + 9.0 * way / np.linalg.norm(way)
        self.target = markers_seen(self.C, self.there)

    def camera(self) -> Floats:
        """One in whose picture marker 1 cannot move unseen."""
        while True:
            C = true_camera(self.random, self.seen)
            ways = self.p1 + 0.5 * np.vstack([np.eye(3), -np.eye(3)])
            seen = [markers_seen(C, p).ravel() for p in ways]
            H = np.stack([seen[i] - seen[i + 3] for i in range(3)], axis=1)
            if np.linalg.svd(H, compute_uv=False)[-1] > LEAST_SEEN:
                return C

    def fit(self, noise: float, more: Floats | None = None) -> Prospect:
        known = blank()
        for p in self.seen if more is None else np.vstack([self.seen, more]):
            points = markers_seen(self.C, p)
            points = points + noise * self.random.standard_normal((2, 2))
            see(known.rows[0], p, points, SHAFT)
        return known

    def plan(self) -> Floats:
        """The next corner."""
        self.tour.rows["goal"] = np.nan
        rcm, reach = RCM.rcm(), Exploration.reach
        plan(self.tour.rows[0], self.v.rows[0], rcm, SHAFT, self.q, self.target, reach)
        return self.tour.goal

    def allowed(self) -> list[Floats]:
        """Corners that may be planned."""
        found, (lower, upper) = [], RCM.limits.arrays
        margin = 0.02 * (upper - lower)
        for steps in product((-1, 0, 1), repeat=3):
            q = self.home + np.array(steps) * self.tour.sides
            free = (q >= lower + margin) & (q <= upper - margin) | (np.array(steps) == 0)
            far = np.linalg.norm(position(RCM.rcm(), q) - self.p1) <= Exploration.reach
            same = (np.abs(q - self.q) <= CORNER_TOLERANCE * np.abs(self.tour.sides)).all()
            found += [q] if free.all() and far and not same else []
        return found


def fitted(known: Prospect, p: Floats, off: Floats | float = 0.0) -> Floats:
    """Where (4,) px from m₀ a fit whose θ is `off` has the markers."""
    theta = np.concatenate([known.A.ravel(), known.g]) + off
    both = np.stack([p, p * (1.0 + SPACING / np.linalg.norm(p))])
    x = np.column_stack([(both - known.origin[:3]) / 100.0, np.ones(2)])
    return ((x @ theta[:8].reshape(2, 4).T) / (1.0 + x[:, :3] @ theta[8:])[:, None]).ravel()


def by_theta(known: Prospect, p: Floats) -> Floats:
    """∂m/∂θ (4, 11) of both markers, by differences."""
    steps = 1e-4 * np.eye(11)
    return np.stack([fitted(known, p, s) - fitted(known, p, -s) for s in steps], axis=1) / 2e-4


def pull(known: Prospect, p: Floats) -> Floats:
    """H⁺ (3, 4) of the fit, by differences."""
    steps = 1e-3 * np.eye(3)
    H = np.stack([fitted(known, p + s) - fitted(known, p - s) for s in steps], axis=1) / 2e-3
    return np.linalg.pinv(H)


def counted(seen: Floats) -> list[Floats]:
    """The places that the sums take."""
    found = [seen[0]]
    for p in seen:
        found += [p] if np.linalg.norm(p - found[-1]) >= MIN_FRAME_SPACING_MM else []
    return found


def the_way(t: Toured) -> Floats:
    """To the target, mm, by the fit as it is here."""
    seen = fitted(t.v, t.p1) + t.v.offset.ravel() + np.tile(t.v.origin[3:], 2)
    return pull(t.v, t.p1) @ (t.target.ravel() - seen)


class Books:
    """What the fit tells of the way to the target, by NumPy alone."""

    def __init__(self, t: Toured) -> None:
        self.v = t.v
        D = np.concatenate([by_theta(t.v, p) for p in counted(t.seen)])
        self.N = D.T @ D + t.v.noise * np.diag([1e-6] * 8 + [1.0] * 3)
        way = the_way(t)
        part = min(10.0 / np.linalg.norm(way), 1.0)
        turned = by_theta(t.v, t.p1 + part * way) - by_theta(t.v, t.p1)
        self.T = pull(t.v, t.p1) @ turned / part

    def error(self, more: Floats | tuple[()] = (), weights: Floats | tuple[()] = ()) -> float:
        """The error expected after more frames with these weights."""
        E = [np.sqrt(w) * by_theta(self.v, p) for p, w in zip(more, weights, strict=True)]
        N = sum((e.T @ e for e in E), self.N)
        return float(np.sqrt(self.v.noise * np.trace(self.T @ np.linalg.solve(N, self.T.T))))


@given(seeds)
@settings(max_examples=20)
def test_the_error_of_the_way_is_that_of_the_books(seed: int) -> None:
    t = Toured(seed)
    error, far = off_target(t.v.rows[0], t.p1, t.target, SHAFT)
    assert error == pytest.approx(Books(t).error(), rel=0.05)
    assert far == pytest.approx(np.linalg.norm(the_way(t)))


@given(seeds, st.booleans(), st.integers(0, 1))
@settings(max_examples=12)
def test_the_next_corner_is_that_of_the_least_error_to_come(
    seed: int, beside: bool, number: int
) -> None:
    """Whatever the limits leave, and in a round of whatever size."""
    t = Toured(seed, beside=beside, number=number)
    frames, errors, corners, books = t.v.frames / 3, [], t.allowed(), Books(t)
    for q in corners:
        to = position(RCM.rcm(), q)
        way = np.stack([t.p1, 0.5 * (t.p1 + to), to])
        errors.append(books.error(way, frames * np.array([1.0, 4.0, 1.0]) / 6.0))
    goal = t.plan()
    chosen = [error for q, error in zip(corners, errors, strict=True) if np.allclose(q, goal)]
    assert chosen and chosen[0] <= min(errors) * 1.01


def test_the_error_to_come_comes_true() -> None:
    """Rms of the way by fits with noise, after the planned leg: as was expected before it."""
    squared, expected = [], []
    for seed in range(12):
        t = Toured(seed)
        there = places(np.stack([t.q, t.plan()]))[1:]
        full = t.fit(0.0, there)
        full.rows["noise"] = 0.3**2
        expected.append(off_target(full.rows[0], t.p1, t.target, SHAFT)[0] ** 2)
        back, exact = pull(full, t.p1), moved(full, t)
        for _ in range(20):
            wrong = moved(t.fit(0.3, there), t) - exact
            squared.append(np.sum((back @ wrong) ** 2))
    assert 0.8 < np.sqrt(np.mean(squared) / np.mean(expected)) < 1.25


def moved(known: Prospect, t: Toured) -> Floats:
    """How far (4,) px the fit has the markers move on the way to the target."""
    return fitted(known, t.there) - fitted(known, t.p1)


def test_servoing_begins_sooner_towards_a_target_whose_direction_is_known_better() -> None:
    """The tool went far to and fro along one way, and hardly across it."""
    ratios = []
    for seed in range(10):
        t = Toured(seed)
        ways = np.linalg.qr(t.random.standard_normal((3, 3)))[0]
        steps = 3.0 * np.linspace(-1.0, 1.0, 30)[:, None] * ways[0]
        t.seen = t.p1 + steps + 0.3 * t.random.standard_normal((30, 3))
        row, shares = t.fit(0.1).rows[0], []
        for way in ways:
            target = markers_seen(t.C, t.p1 + 3.0 * way)
            error, far = off_target(row, t.p1, target, SHAFT)
            shares.append(error / far)
        ratios.append(shares[0] / np.mean(shares[1:]))
    assert np.median(ratios) < 0.6


@given(seeds)
@settings(max_examples=10)
def test_the_direction_is_known_from_the_share_of_the_way_that_is_set(seed: int) -> None:
    """And where the error is so small that it does not matter."""
    t = Toured(seed, noise=1.0)
    error, far = off_target(t.v.rows[0], t.p1, t.target, SHAFT)
    for limit in (0.9, 1.1):
        x = as_row(Exploration(uncertainty=limit * error / far))[0]
        assert directed(t.v.rows[0], t.p1, t.target, SHAFT, x) == (
            limit > 1.0 or error <= NEGLIGIBLE_ERROR_MM
        )


@given(seeds)
@settings(max_examples=10)
def test_an_error_too_small_to_matter_is_none_however_large_a_share_of_the_way_it_is(
    seed: int,
) -> None:
    for noise in (3.0, 6.0, 12.0, 24.0):  # until the error is a large share of the way
        t = Toured(seed, noise)
        a_mm = aimed(t, 0.1)[0] / 0.1
        if a_mm > 3.0 * X["uncertainty"]:
            break
    for share in (0.2, 0.8, 1.25, 3.0):
        error, far = aimed(t, share * NEGLIGIBLE_ERROR_MM / a_mm)
        if error > 2.0 * X["uncertainty"] * far:
            assert directed(t.v.rows[0], t.p1, t.target, SHAFT, X) == (error <= NEGLIGIBLE_ERROR_MM)


def aimed(t: Toured, mm: float) -> tuple[float, float]:
    """Error and way to a target that the fit has so many mm away."""
    way = (t.there - t.p1) / np.linalg.norm(t.there - t.p1)
    t.target = fitted(t.v, t.p1 + mm * way).reshape(2, 2) + t.v.origin[3:] + t.v.offset
    return off_target(t.v.rows[0], t.p1, t.target, SHAFT)


@given(seeds)
@settings(max_examples=10)
def test_at_the_target_the_direction_does_not_matter_and_a_corner_is_planned_all_the_same(
    seed: int,
) -> None:
    t = Toured(seed)
    t.target = markers_seen(t.C, t.p1) + t.v.offset
    assert directed(t.v.rows[0], t.p1, t.target, SHAFT, X)
    assert any(np.allclose(t.plan(), q) for q in t.allowed())


def test_of_what_no_frame_tells_no_direction_is_known_and_the_corner_stays() -> None:
    t = Toured(0)
    t.v = blank()
    assert not directed(t.v.rows[0], t.p1, t.target, SHAFT, X)
    assert np.isnan(t.plan()).all()
