"""Disturbances that a servo may not detect: their effects on the frames, in time and afterwards."""

from typing import NamedTuple

import numpy as np
import pytest

from rcmservo.interfaces import Command, Floats, Frame
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.sim.camera_model import CameraModel
from rcmservo.tracking import ColourMarkers

START, END = 0.2, 0.7
"""Start and end of the disturbances, s."""

TRANSIENT = [
    "freeze:at=0.2,for=0.5",
    "freeze:at=0.2,for=0.5,marker=2",
    "decoy:at=0.2,for=0.5,every=2,marker=2",
    "decoy:at=0.2,for=0.5,px=0,speed=40",
    "camera_clock:at=0.2,for=0.5,of=exposures,s=0.03",
    "camera_clock:at=0.2,for=0.5,of=exposures",
]
"""Disturbances that leave no effect."""

PERMANENT = [
    "camera_pan:at=0.2,for=0.5,px=20",
    "camera_roll:at=0.2,for=0.5,deg=10",
    "camera_dolly:at=0.2,for=0.5,mm=-10",
    "camera_zoom:at=0.2,share=0.05",
]
"""Disturbances after which the camera stays as it is."""


class TrueFrame(NamedTuple):
    """Frame with its ground truth."""

    time: float
    """True time (s) of the exposure, from the start of the run."""
    frame: Frame
    error: Floats
    """Errors (2, 2) px of the markers from their images by the first camera."""
    optics: CameraModel
    """True camera."""


def true_frames(text: str, seconds: float = 1.0) -> list[TrueFrame]:
    """Return the frames of a camera without noise, of a tool that moves all the time."""
    rig = Rig(1, RigSettings(point_noise=0.0), False, [Disturbance.parse(text)])
    first, found = rig.scene.optics, list[TrueFrame]()
    rig.begin()
    rig.arm.enable()
    began = rig.clock.now()
    for k in range(round(seconds * 100)):
        rig.clock.wait_until(began + (k + 1) * 10_000_000)
        now = rig.clock.now()
        rig.arm.apply(Command(k, now, now + 50_000_000, np.array([0.05, -0.05, 5.0]), True))
        frame = rig.camera.latest()
        if frame is not None and not (found and frame.number == found[-1].frame.number):
            true = round(frame.number * 1e9 / 60)
            pixels = first.project(rig.truth.markers(true))
            assert frame.points is not None
            time = (true - began) * 1e-9
            found.append(TrueFrame(time, frame, frame.points - pixels, rig.scene.optics))
    return found


def during(samples: list[TrueFrame]) -> list[TrueFrame]:
    return [sample for sample in samples if START <= sample.time < END]


def errors_of(samples: list[TrueFrame], i: int) -> Floats:
    """Return the error (px) of marker i, from 0, in each frame."""
    return np.array([np.linalg.norm(sample.error[i]) for sample in samples])


@pytest.mark.parametrize("text", [*TRANSIENT, *PERMANENT])
def test_a_disturbance_acts_from_its_start_and_not_before(text: str) -> None:
    samples = true_frames(text)
    before = [sample for sample in samples if sample.time < START]
    assert len(before) > 8
    assert max(errors_of(before, 0).max(), errors_of(before, 1).max()) < 1e-9
    apart = [
        sample.frame.exposure - round(sample.frame.number * 1e9 / 60) for sample in during(samples)
    ]
    assert (
        any(apart)
        or max(errors_of(during(samples), 0).max(), errors_of(during(samples), 1).max()) > 1.0
    )


@pytest.mark.parametrize("text", TRANSIENT)
def test_a_transient_disturbance_leaves_no_effect(text: str) -> None:
    after = [sample for sample in true_frames(text) if sample.time >= END + 0.05]
    assert len(after) > 8
    assert max(errors_of(after, 0).max(), errors_of(after, 1).max()) < 1e-9
    assert all(sample.frame.exposure == round(sample.frame.number * 1e9 / 60) for sample in after)


@pytest.mark.parametrize("text", PERMANENT)
def test_a_camera_stays_as_it_is_after_its_motion(text: str) -> None:
    samples = true_frames(text)
    after = [sample.optics for sample in samples if sample.time >= END]
    assert len({id(optics) for optics in after}) == 1
    assert min(errors_of(samples[-5:], 0).max(), errors_of(samples[-5:], 1).max()) > 0.5


def test_frames_of_a_frozen_image_have_fresh_numbers_and_times() -> None:
    samples = during(true_frames("freeze:at=0.2,for=0.5"))
    assert (
        len(
            {sample.frame.points.tobytes() for sample in samples if sample.frame.points is not None}
        )
        == 1
    )
    assert np.all(np.diff([sample.frame.number for sample in samples]) == 1)
    assert np.ptp(np.diff([sample.frame.exposure for sample in samples])) <= 1
    assert np.all(np.diff(errors_of(samples, 0)) > 0.0)


@pytest.mark.parametrize("marker", [1, 2])
def test_one_frozen_marker_stays_and_the_other_moves(marker: int) -> None:
    samples = during(true_frames(f"freeze:at=0.2,for=0.5,marker={marker}"))
    positions = np.array([sample.frame.points for sample in samples])
    assert np.ptp(positions[:, marker - 1], axis=0).max() < 1e-9
    assert errors_of(samples, 2 - marker).max() < 1e-9
    assert errors_of(samples, marker - 1)[-1] > 1.0


def test_a_flickering_decoy_is_in_every_second_frame() -> None:
    samples = during(true_frames("decoy:at=0.2,for=0.5,every=2,marker=2,px=30"))
    assert errors_of(samples, 0).max() < 1e-9
    halves = errors_of(samples[::2], 1), errors_of(samples[1::2], 1)
    without_decoy, with_decoy = sorted(halves, key=np.max)
    assert without_decoy.max() < 1e-9
    assert np.allclose(with_decoy, 30.0)


def test_a_decoy_slides_away_from_the_true_marker_in_one_direction() -> None:
    samples = during(true_frames("decoy:at=0.2,for=0.5,px=0,speed=40,marker=2"))
    assert errors_of(samples, 0).max() < 1e-9
    assert np.allclose(
        errors_of(samples, 1), [40.0 * (sample.time - START) for sample in samples], atol=1e-6
    )
    directions = (
        np.array([sample.error[1] for sample in samples[1:]]) / errors_of(samples[1:], 1)[:, None]
    )
    assert np.ptp(directions, axis=0).max() < 1e-6


def test_a_decoy_outside_the_image_is_not_found() -> None:
    last = true_frames("decoy:at=0,px=0,speed=1000", 1.5)[-1]
    assert last.frame.points is not None
    assert list(np.isnan(last.frame.points).all(axis=1)) == [True, False]


def test_a_pan_moves_the_image_at_its_speed() -> None:
    samples = during(true_frames("camera_pan:at=0.2,for=0.5,px=20"))
    expected = np.array([40.0 * (sample.time - START) for sample in samples])
    for i in range(2):
        assert np.all(np.abs(errors_of(samples, i) - expected) <= 0.2 * expected + 1e-6)


def test_a_rolling_camera_rotates_about_its_optical_axis() -> None:
    samples = true_frames("camera_roll:at=0.2,for=0.5,deg=10")
    first, last = samples[0].optics, samples[-1].optics
    turn = last.rotation @ first.rotation.T
    assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) == pytest.approx(10.0)
    assert np.allclose(last.position, first.position)


def test_a_dolly_moves_the_camera_along_its_optical_axis() -> None:
    samples = true_frames("camera_dolly:at=0.2,for=0.5,mm=8")
    first, last = samples[0].optics, samples[-1].optics
    assert np.allclose(last.position - first.position, 8.0 * first.rotation[2])
    assert np.allclose(last.rotation, first.rotation)


def test_a_zoom_changes_the_focal_length_at_once() -> None:
    samples = true_frames("camera_zoom:at=0.2,share=0.05")
    focal = np.array([sample.optics.focal / samples[0].optics.focal for sample in samples])
    assert np.all((np.abs(focal - 1.05) < 1e-9) == [sample.time >= START for sample in samples])


@pytest.mark.parametrize("s", [0.03, -0.03])
def test_an_offset_of_exposures_shifts_only_their_stamps(s: float) -> None:
    for sample in during(true_frames(f"camera_clock:at=0.2,for=0.5,of=exposures,s={s}"))[2:-2]:
        true = round(sample.frame.number * 1e9 / 60)
        assert sample.frame.exposure - true == round(s * 1e9)
        assert sample.frame.arrival - true == 22_000_000


@pytest.mark.parametrize("s", [0.03, -0.03])
def test_an_offset_of_the_cameras_clock_shifts_both_stamps(s: float) -> None:
    for sample in during(true_frames(f"camera_clock:at=0.2,for=0.5,s={s}"))[2:-2]:
        true = round(sample.frame.number * 1e9 / 60)
        assert sample.frame.exposure - true == round(s * 1e9)
        assert sample.frame.arrival - sample.frame.exposure == 22_000_000


def images(text: str, *moments: float) -> tuple[Rig, list[Frame]]:
    """Return images at so many s after the start, of a tool at rest."""
    rig = Rig(2, pictures=True, disturbances=[Disturbance.parse(text)])
    rig.begin()
    began, frames = rig.clock.now(), list[Frame]()
    for moment in moments:
        rig.clock.wait_until(began + round(moment * 1e9))
        frame = rig.camera.latest()
        assert frame is not None
        frames.append(frame)
    return rig, frames


def test_a_frozen_image_repeats_its_noise() -> None:
    _, (before, first, *others) = images("freeze:at=0.1", 0.1, 0.15, 0.2, 0.3)
    assert not np.array_equal(before.image, first.image)
    assert all(np.array_equal(first.image, other.image) for other in others)
    assert others[-1].number > first.number


@pytest.mark.parametrize(
    ("text", "distance"),
    [("decoy:px=0,speed=100,marker=2", 40.0), ("freeze:marker=2", 0.0)],
)
def test_a_decoy_is_found_at_its_position_in_images(text: str, distance: float) -> None:
    tracker = ColourMarkers()
    rig, frames = images(text, 0.1, 0.422)
    found = [tracker.find(frame).points for frame in frames][-1]
    true = rig.truth.pixels(rig.truth.joints_at(frames[-1].exposure))
    error = np.linalg.norm(found - true, axis=1)
    assert error[0] < 1.0
    assert error[1] == pytest.approx(distance, abs=2.5)
