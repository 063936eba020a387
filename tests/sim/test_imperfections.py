"""Imperfections of the simulated arm, tool and camera: each does what its name says."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import PitchYawRcm, SphericalRcm
from rcmservo.interfaces import Floats
from rcmservo.sim import Rig, RigSettings
from rcmservo.sim.arm import Drive, SimulatedArm
from rcmservo.sim.imperfect_markers import BEND_INTERVAL_NS, PORT_PERIOD_S
from rcmservo.sim.imperfections import ARMS, Imperfections
from rcmservo.sim.rig_file import read_rig_settings

MECHANISMS = {"spherical": SphericalRcm(), "pitch-yaw": PitchYawRcm()}


def draw_joints(random: np.random.Generator, settings: RigSettings) -> Floats:
    lower, upper = settings.mechanism.limits.arrays
    return random.uniform(lower, upper)


def make_settings(mechanism: str = "spherical", **imperfections: float) -> RigSettings:
    return RigSettings(
        mechanism=MECHANISMS[mechanism],
        point_noise=0.0,
        imperfections=Imperfections(**imperfections),
    )


def displace(settings: RigSettings, seed: int, q: Floats) -> Floats:
    """Return how far (2, 3) the markers of a resting arm are from those of an ideal one, mm."""
    ideal = replace(settings, imperfections=Imperfections())
    return settings.make_body(seed).points(q)[:2] - ideal.make_body(seed).points(q)[:2]


@given(seeds, st.floats(-0.5, 0.5), st.floats(-20.0, 20.0))
def test_spacing_and_insertion_move_the_markers_along_the_tool(
    seed: int, spacing: float, insertion_mm: float
) -> None:
    q = np.array([1.0, 0.5, 120.0])
    settings = make_settings(spacing_error=spacing, insertion_error=insertion_mm)
    p1, p2, *_ = settings.make_body(seed).points(q)
    ideal_1, ideal_2, *_ = make_settings().make_body(seed).points(q)
    axis = ideal_1 / np.linalg.norm(ideal_1)
    np.testing.assert_allclose(p1, ideal_1 + insertion_mm * axis, atol=1e-9)
    np.testing.assert_allclose(p2 - p1, (1.0 + spacing) * (ideal_2 - ideal_1), atol=1e-9)


@given(seeds, st.floats(0.0, 0.5))
def test_tissue_bends_the_tool_back_across_its_axis_on_one_side(seed: int, bend: float) -> None:
    bent, ideal = make_settings(tissue_bend=bend), make_settings()
    (lower, upper), errors = ideal.mechanism.limits.arrays, bent.imperfections.draw(seed)
    middle = ideal.make_body(seed).points(0.5 * (lower + upper))[0]
    for q in np.linspace(lower, upper, 7):
        points, straight = (one.make_body(seed).points(q)[:2] for one in (bent, ideal))
        depths = (straight - middle) @ errors.tissue_side
        axis = straight[0] / np.linalg.norm(straight[0])
        across = errors.tissue_side - (errors.tissue_side @ axis) * axis
        expected = -bend * np.maximum(depths, 0.0)[:, None] * across
        np.testing.assert_allclose(points - straight, expected, atol=1e-9)


@pytest.mark.parametrize("mechanism", MECHANISMS)
@given(seed=seeds)
def test_markers_are_as_far_from_the_axis_in_every_pose(mechanism: str, seed: int) -> None:
    settings = make_settings(mechanism, marker_distance=3.0, roll=0.7)
    for _ in range(5):
        q = draw_joints(make_random(seed), settings)
        direction = settings.make_body(seed).points(q)[3] - settings.make_body(seed).points(q)[1]
        offsets = displace(settings, seed, q)
        np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), 3.0, atol=1e-9)
        np.testing.assert_allclose(offsets @ direction, 0.0, atol=1e-9)


@pytest.mark.parametrize("mechanism", MECHANISMS)
@given(seed=seeds)
def test_the_insertion_axis_misses_the_rcm_by_its_distance(mechanism: str, seed: int) -> None:
    settings = make_settings(mechanism, insertion_distance=2.0)
    q = draw_joints(make_random(seed), settings)
    p1, p2, shaft, _ = settings.make_body(seed).points(q)
    along = (p2 - p1) / np.linalg.norm(p2 - p1)
    np.testing.assert_allclose(np.linalg.norm(p1 - along * (along @ p1)), 2.0, atol=1e-9)
    assert np.linalg.norm(shaft) == pytest.approx(2.0)


@pytest.mark.parametrize("mechanism", MECHANISMS)
@given(seed=seeds)
def test_axes_apart_move_all_points_perpendicular_to_both_axes(mechanism: str, seed: int) -> None:
    """The displacement turns with the outer hinge only."""
    settings = make_settings(mechanism, axis_distance=1.5)
    q = draw_joints(make_random(seed), settings)
    first, second = displace(settings, seed, q)
    outer = 1 if mechanism == "spherical" else 0
    axis = np.array([0.0, 0.0, 1.0]) if mechanism == "spherical" else np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(first, second, atol=1e-9)
    assert np.linalg.norm(first) == pytest.approx(1.5) and abs(first @ axis) < 1e-9
    moved = q + np.where(np.arange(3) == outer, 0.0, 0.1)
    np.testing.assert_allclose(displace(settings, seed, moved)[0], first, atol=1e-9)


def test_a_motion_bends_the_shaft_back_by_its_lateral_speed() -> None:
    settings = make_settings(friction_bend=0.02)
    body, q = settings.make_body(0), np.array([1.0, 0.5, 120.0])
    before = q - np.array([0.1, -0.2, 5.0]) * BEND_INTERVAL_NS * 1e-9
    speeds = (body.points(q)[:2] - body.points(before)[:2]) / (BEND_INTERVAL_NS * 1e-9)
    along = (body.points(q)[1] - body.points(q)[0]) / 30.0
    lateral = speeds - np.outer(speeds @ along, along)
    bent = body.points(q, before)[:2] - body.points(q)[:2]
    np.testing.assert_allclose(bent, -0.02 * lateral, atol=1e-9)


def test_the_port_moves_with_its_amplitude() -> None:
    body, q = make_settings(port_motion=5.0).make_body(3), np.array([1.0, 0.5, 120.0])
    times = np.linspace(0, PORT_PERIOD_S * 1e9, 200).astype(int)
    path = np.array([body.points(q, q, int(time))[0] for time in times]) - body.points(q, q, 0)[0]
    assert np.ptp(path, axis=0).max() <= 10.0 + 1e-9
    span = np.linalg.norm(path.max(axis=0) - path.min(axis=0))
    assert span == pytest.approx(10.0, rel=1e-2)


@given(seeds, st.floats(0.1, 0.9))
def test_the_tool_follows_only_a_motion_beyond_the_backlash(seed: int, fraction: float) -> None:
    backlash = (0.01, 0.01, 0.5)
    errors = Imperfections(backlash=backlash).draw(seed)
    arm = SimulatedArm(SphericalRcm(), Drive(deadband=(0.0, 0.0, 0.0)), errors)
    arm.place(np.array([1.0, 0.5, 100.0]))
    half, there = 0.5 * np.array(backlash), arm.q_motor
    command = (fraction * half).tolist()
    arm.control(command, True)
    arm.advance_until(arm.time + 10**9)
    assert np.array_equal(arm.q_true, there)  # within the gap the tool rests
    assert (arm.q_motor - there > 0.8 * fraction * half).all()
    arm.control((2.0 * half).tolist(), True)
    arm.advance_until(arm.time + 2 * 10**9)
    np.testing.assert_allclose(arm.q_motor - arm.q_true, half, rtol=1e-6)
    np.testing.assert_allclose(arm.measure().q, arm.q_motor, atol=2e-3)  # encoders at the motors


def test_each_seed_is_another_arm_and_the_same_one_again() -> None:
    settings, q = make_settings(marker_distance=1.0), np.array([1.0, 0.5, 120.0])
    assert np.array_equal(displace(settings, 5, q), displace(settings, 5, q))
    assert not np.allclose(displace(settings, 5, q), displace(settings, 6, q), atol=1e-3)


def test_reported_joints_are_repeated_under_fresh_times() -> None:
    rig = Rig(0, make_settings(report_period=0.02), pictures=False)
    rig.truth.arm.control([0.0, 0.0, 20.0], True)
    measured = []
    for _ in range(40):
        rig.clock.wait_until(rig.clock.now() + 1_000_000)
        measured.append(rig.arm.measure())
    assert len({one.time for one in measured}) == 40
    assert 2 <= len({tuple(one.q) for one in measured}) <= 3


@pytest.mark.parametrize("seed", range(4))
def test_frames_have_the_wrong_exposure_by_the_stamp_error(seed: int) -> None:
    exact, wrong = (
        Rig(seed, make_settings(stamp_error=error), pictures=False).camera.latest()
        for error in (0.0, 0.004)
    )
    assert exact is not None and wrong is not None
    assert abs(wrong.exposure - exact.exposure) == 4_000_000
    assert (wrong.number, wrong.arrival) == (exact.number, exact.arrival)


def image_of_moving_tool(settings: RigSettings) -> Floats:
    """Return the markers (2, 2) px of a frame while the insertion moves at 20 mm/s."""
    return image_from_centre(settings)[0]


def image_from_centre(settings: RigSettings) -> tuple[Floats, Floats]:
    """Return these markers, and their images from the principal point."""
    rig = Rig(2, settings, pictures=False)
    rig.truth.arm.control([0.0, 0.0, 20.0], True)
    rig.clock.wait_until(rig.clock.now() + 500_000_000)
    frame = rig.camera.latest()
    assert frame is not None and frame.points is not None
    return frame.points, frame.points - rig.scene.optics.centre


def test_a_row_is_read_out_at_its_time() -> None:
    """A marker below the middle of the image is seen later, one above it earlier."""
    exact, shifted = (image_of_moving_tool(make_settings(read_out=t)) for t in (0.0, 0.02))
    later = image_of_moving_tool(replace(make_settings(), drive=Drive(delay=0.003)))
    speeds = (exact - later) / 0.001  # px/s: the arm began 1 ms earlier
    delays = 0.02 * (exact[:, 1] / 480.0 - 0.5)
    np.testing.assert_allclose(np.abs(shifted - exact), np.abs(speeds * delays[:, None]), rtol=0.05)


def test_the_focal_length_scales_the_image_about_its_centre() -> None:
    exact, changed = (image_from_centre(make_settings(focus=f))[1] for f in (0.0, 0.01))
    scales = changed / exact
    np.testing.assert_allclose(scales, scales[0, 0], rtol=1e-6)
    assert 0.99 <= scales[0, 0] <= 1.01 and scales[0, 0] != 1.0


def test_the_air_moves_markers_slowly_with_its_deviation() -> None:
    settings = make_settings(air=0.5)
    samples, steps = [], []
    for seed in range(40):
        rig = Rig(seed, settings, pictures=False)
        exact = rig.truth.pixels(rig.truth.arm.q_true)
        for _ in range(60):
            rig.clock.wait_until(rig.clock.now() + 16_666_667)
            frame = rig.camera.latest()
            assert frame is not None and frame.points is not None
            samples.append(frame.points - exact)
        steps.append(np.diff(np.array(samples[-60:]), axis=0))
    assert np.std(samples) == pytest.approx(0.5, rel=0.15)
    assert np.std(steps) < 0.4 * np.std(samples)


def test_an_ideal_arm_has_none_and_the_same_scenes() -> None:
    ideal, worn = (
        Rig(4, read_rig_settings(RigDescription(), arm), pictures=False)
        for arm in ("ideal", "worn")
    )
    assert ideal.settings == RigSettings() and ideal.settings.imperfections.is_ideal
    assert np.array_equal(ideal.scene.path, worn.scene.path)
    assert not worn.settings.imperfections.is_ideal


def test_a_worn_arm_is_twice_as_far_from_the_ideal_as_a_good_one() -> None:
    good, worn = (read_rig_settings(RigDescription(), arm) for arm in ("good", "worn"))
    for one in fields(Imperfections):
        np.testing.assert_allclose(
            getattr(worn.imperfections, one.name),
            2.0 * np.array(getattr(good.imperfections, one.name)),
        )
    assert (good.drive.lag, worn.drive.lag) == (0.03, 0.06) and set(ARMS) == {
        "ideal",
        "good",
        "worn",
    }


@pytest.mark.parametrize(
    "invalid", [{"air": -1.0}, {"backlash": (0.1, 0.1)}, {"focus": 2.0}, {"axis_distance": np.nan}]
)
def test_impossible_sizes_are_refused(invalid: dict[str, float]) -> None:
    with pytest.raises(BadInput, match=f"imperfections.{next(iter(invalid))}"):
        Imperfections(**invalid)
