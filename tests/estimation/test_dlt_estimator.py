"""The recursive direct linear transformation: right wherever the RCM is, nearer with noise, and it
takes the noise out of the markers. What it is made of is tested in test_prospect.py.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conftest import SHAFT, SPACING, derivative, frozen, random_from, seeds
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_fit import Prospect
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.geometry.features import SCALE, about, features
from rcmservo.geometry.tool import RigidTool, second_marker
from rcmservo.interfaces import Floats

TOOL = RigidTool(SPACING)
DLT = DltEstimator()

depths = st.sampled_from([-0.5, -0.05, 0.05, 1.0])
"""Of the RCM, as shares of the tool's: behind the camera, about its image plane, before it."""


def camera(random: np.random.Generator, middle: Floats, rcm_depth: float) -> Floats:
    """A calibration matrix C (3, 4) of a camera that looks at `middle` (3,) mm."""
    away = random.uniform(45.0, 75.0)
    across = np.cross(middle, random.standard_normal(3))
    across /= np.linalg.norm(across)
    along = middle / np.linalg.norm(middle)
    cosine = away * (1.0 - rcm_depth) / np.linalg.norm(middle)
    forward = cosine * along + np.sqrt(1.0 - cosine**2) * across
    right = np.cross(forward, random.standard_normal(3))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 240.0], [0.0, 0.0, 1.0]])
    return K @ np.column_stack([rotation, -rotation @ (middle - away * forward)])


def seen(C: Floats, p1: Floats) -> Floats:
    points = np.column_stack([np.stack([p1, second_marker(SHAFT, p1)]), np.ones(2)]) @ C.T
    return points[:, :2] / points[:, 2:]


def places(random: np.random.Generator, count: int) -> Floats:
    """p₁ (count, 3) mm in a cloud of ±15 mm that keeps away from the RCM."""
    way = random.standard_normal(3)
    return 120.0 * way / np.linalg.norm(way) + random.uniform(-15.0, 15.0, (count, 3))


def taught(estimator: Estimator, C: Floats, way: Floats, noise: Floats, o_c: Floats) -> Floats:
    """Ĵ (3, 3), scaled, at the last of the places `way` (n, 3), with `noise` (n, 2, 2) px."""
    memory = estimator.init()
    for p1, off in zip(way, noise, strict=True):
        sample = Sample(p1, seen(C, p1) + off, o_c, 1.0 / 60.0)
        memory = estimator.update(memory, TOOL, sample)
    exact = Sample(way[-1], seen(C, way[-1]), o_c, 1.0 / 60.0)
    return estimator.jacobian(memory, TOOL, exact) / SCALE[:, None]


def true_jacobian(C: Floats, p1: Floats, o_c: Floats) -> Floats:
    return derivative(lambda p: features(about(seen(C, p), o_c)), p1, 1e-2) / SCALE[:, None]


@given(seeds, depths)
def test_from_exact_pictures_it_learns_the_jacobian_wherever_the_rcm_is(
    seed: int, depth: float
) -> None:
    random = random_from(seed)
    way = places(random, 40)
    C, o_c = camera(random, way.mean(axis=0), depth), random.uniform(-200.0, 800.0, 2)
    J = true_jacobian(C, way[-1], o_c)
    J_hat = taught(DLT, C, way, np.zeros((40, 2, 2)), o_c)
    assert np.linalg.norm(J_hat - J) < 0.02 * np.linalg.norm(J)


def test_behind_the_camera_the_nine_numbers_about_the_rcm_do_not() -> None:
    """And before it they do: the other estimator is not broken here."""
    wrong = {}
    for depth in (-0.5, 1.0):
        random = random_from(3)
        way = places(random, 40)
        C = camera(random, way.mean(axis=0), depth)
        o_c = (C[:, 3] / C[2, 3])[:2]
        J = true_jacobian(C, way[-1], o_c)
        J_hat = taught(ProjectionEstimator(), C, way, np.zeros((40, 2, 2)), o_c)
        wrong[depth] = np.linalg.norm(J_hat - J) / np.linalg.norm(J)
    assert wrong[-0.5] > 0.3 and wrong[1.0] < 0.05


@given(seeds)
def test_an_imaged_rcm_that_is_off_does_it_no_harm(seed: int) -> None:
    random = random_from(seed)
    way, noise = places(random, 100), 0.3 * random.standard_normal((100, 2, 2))
    C, wrong = camera(random, way.mean(axis=0), 0.3), []
    for off in (np.zeros(2), np.array([30.0, 40.0])):
        o_c = (C[:, 3] / C[2, 3])[:2] + off
        J = true_jacobian(C, way[-1], o_c)
        J_hat = taught(DLT, C, way, noise, o_c)
        wrong.append(np.linalg.norm(J_hat - J) / np.linalg.norm(J))
    assert max(wrong) < 0.05


def still(noise: Floats, bias: float = 0.0) -> tuple[Floats, Floats]:
    """Where it has the markers of a tool that has come to rest, in frames with this noise; and
    where they are.
    """
    random = random_from(5)
    way = places(random, 40)
    C, o_c, memory = camera(random, way.mean(axis=0), 1.0), np.zeros(2), DLT.init()
    for p1 in way:
        memory = DLT.update(memory, TOOL, Sample(p1, seen(C, p1), o_c, 0.0))
    points = seen(C, way[-1]) + bias
    for off in noise:
        sample = Sample(way[-1], points + off, o_c, 0.0)
        memory = DLT.update(memory, TOOL, sample)
    return DLT.located(memory, TOOL, sample), points


def test_at_rest_it_averages_the_noise_of_the_markers() -> None:
    noise = 0.3 * random_from(0).standard_normal((200, 2, 2))
    located, points = still(noise)
    assert np.abs(located - points).max() < 4.0 * 0.3 / np.sqrt(200)


def test_what_the_fit_does_not_explain_it_follows() -> None:
    """A camera that moved by 2 px since: after as many frames as the mean is of, that is gone."""
    located, points = still(np.zeros((1000, 2, 2)), bias=2.0)
    assert np.abs(located - points).max() < 0.1
    early, _ = still(np.zeros((1, 2, 2)), bias=2.0)
    assert np.abs(early - points).max() > 0.5


def test_one_frame_tells_no_more_than_how_the_tool_runs_through_the_picture() -> None:
    random = random_from(1)
    p1 = places(random, 1)[0]
    points = seen(camera(random, p1, 1.0), p1)
    sample = Sample(p1, points, np.zeros(2), 0.0)
    memory = DLT.update(DLT.init(), TOOL, sample)
    strengths = np.linalg.svd(DLT.jacobian(memory, TOOL, sample) / SCALE[:, None])[1]
    assert strengths[1] < 1e-3 * strengths[0]
    np.testing.assert_allclose(DLT.located(memory, TOOL, sample), points, atol=1e-9)


@given(seeds, depths)
def test_the_imaged_rcm_is_where_the_camera_would_see_it_before_behind_or_beside_the_picture(
    seed: int, depth: float
) -> None:
    random = random_from(seed)
    way, memory = places(random, 40), DLT.init()
    C = camera(random, way.mean(axis=0), depth)
    for p1 in way:
        memory = DLT.update(memory, TOOL, Sample(p1, seen(C, p1), np.full(2, np.nan), 0.0))
    o_c, covariance = DLT.imaged_rcm(memory)
    wanted, near = (C[:, 3] / C[2, 3])[:2], seen(C, way[-1])[0]
    assert np.linalg.norm(o_c - wanted) < 0.02 * np.linalg.norm(wanted - near)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


@given(seeds)
def test_what_it_predicts_is_where_the_markers_are_from_the_imaged_rcm(seed: int) -> None:
    random = random_from(seed)
    way, memory = places(random, 40), DLT.init()
    C = camera(random, way.mean(axis=0), 1.0)
    for p1 in way:
        memory = DLT.update(memory, TOOL, Sample(p1, seen(C, p1), np.zeros(2), 0.0))
    wanted = (seen(C, way[0]) - (C[:, 3] / C[2, 3])[:2]).ravel()
    assert np.abs(DLT.predict(memory, TOOL, way[0]) - wanted).max() < 0.05 * np.abs(wanted).max()


def test_a_memory_is_never_written_into() -> None:
    one, other = places(random_from(0), 2)
    memory = DLT.update(DLT.init(), TOOL, Sample(one, np.ones((2, 2)), np.zeros(2), 0.0))
    learnt = frozen(Prospect(memory))
    after = DLT.update(memory, TOOL, Sample(other, np.ones((2, 2)), np.zeros(2), 0.0))
    assert frozen(Prospect(memory)) == learnt != frozen(Prospect(after))
