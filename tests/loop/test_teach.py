"""A failure to teach gives the reason: camera, clock, light, or the marker concerned."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import Laboratory, make_laboratory, make_observation
from rcmservo.interfaces import Floats, Frame, Image, Markers, Tracker
from rcmservo.loop.detection_failure import explain_undetected_markers
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.target_frames import TargetFrames
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.tracking import ColourMarkers, MarkerAppearance, PointMarkers

LOOK = MarkerAppearance("green", "blue", 3.5, 3.5)
BACKGROUND = (70, 80, 120)
PAINT = {"green": (40, 190, 50), "blue": (215, 80, 30), "red": (40, 30, 210)}
GREEN, BLUE = ("green", 80.0, 100.0, 14.0), ("blue", 200.0, 120.0, 14.0)
SECOND_NS = 1_000_000_000

Change = Callable[[Frame], Frame | None]


class Changed:
    """Camera of the laboratory with a change of every frame."""

    def __init__(self, lab: Laboratory, change: Change) -> None:
        self._camera, self._change = lab.rig.camera, change
        self._source: Frame | None = None
        self._changed: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self._camera.latest()
        if frame is not self._source:
            self._source = frame
            self._changed = None if frame is None else self._change(frame)
        return self._changed


def draw_balls(*balls: tuple[str, float, float, float]) -> Image:
    """Return an image of balls with colour, u, v and radius on a plain background."""
    image = np.full((240, 320, 3), BACKGROUND, dtype=np.uint8)
    v, u = np.mgrid[:240, :320]
    for colour, x, y, radius in balls:
        image[(u - x) ** 2 + (v - y) ** 2 < radius**2] = PAINT[colour]
    return image


def reason(change: Change, tracker: Tracker | None = None) -> str:
    """Return the reason for failed teaching with changed frames."""
    lab = make_laboratory()
    plant = Plant(lab.rig.arm, Changed(lab, change), tracker or PointMarkers(), lab.rig.clock)
    with pytest.raises(TeachingFailed) as caught:
        teach(plant, frames=30)
    start, _, why = str(caught.value).partition(": ")
    assert start == "the target cannot be taught" and "\n" not in why
    return why


def reason_of(image: Image, look: MarkerAppearance = LOOK) -> str:
    """Return the reason for failed teaching with a constant image."""
    return reason(lambda frame: replace(frame, points=None, image=image), ColourMarkers(look))


def test_two_visible_balls_are_taught() -> None:
    image, lab = draw_balls(GREEN, BLUE), make_laboratory()
    camera = Changed(lab, lambda frame: replace(frame, points=None, image=image))
    target = teach(Plant(lab.rig.arm, camera, ColourMarkers(LOOK), lab.rig.clock), frames=30)
    np.testing.assert_allclose(target.points, [[80.0, 100.0], [200.0, 120.0]], atol=0.3)


def test_a_camera_without_frames_is_the_reason() -> None:
    assert reason(lambda frame: None) == "the camera has delivered no frame for 2.0 s"


def test_a_camera_that_stops_is_the_reason_rather_than_the_markers() -> None:
    began: list[int] = []

    def change(frame: Frame) -> Frame | None:
        began.append(frame.exposure)
        blind = replace(frame, points=np.full((2, 2), np.nan))
        return blind if frame.exposure < began[0] + SECOND_NS else None

    why = reason(change)
    assert why.startswith("the camera has delivered no frame for") and why.endswith(" s")


@pytest.mark.parametrize(("ahead", "age"), [(10 * SECOND_NS, "-"), (-10 * SECOND_NS, "10.0")])
def test_a_false_clock_is_the_reason_with_the_age_of_its_frames(ahead: int, age: str) -> None:
    why = reason(lambda frame: replace(frame, exposure=frame.exposure + ahead))
    assert why.startswith(f"the frames have impossible timestamps: the newest arrived {age}")
    assert why.endswith(" s after its exposure; expected 0 to 2 s")


def test_an_exposure_that_does_not_rise_is_the_reason() -> None:
    exposures: list[int] = []

    def change(frame: Frame) -> Frame:
        exposures.append(frame.exposure)
        exposure = min(frame.exposure, exposures[0] + SECOND_NS)
        return replace(frame, exposure=exposure, points=np.full((2, 2), np.nan))

    why = reason(change)
    assert why.startswith("the frames have impossible timestamps: the newest was exposed 0.000 s ")
    assert why.endswith("after the previous one; expected more than 0 s")


def test_the_first_frame_may_still_arrive() -> None:
    lab = make_laboratory()
    plant = Plant(lab.rig.arm, Changed(lab, lambda frame: None), PointMarkers(), lab.rig.clock)
    why = explain_undetected_markers(plant, plant.read(), plant.clock.now())
    assert why == "the camera has delivered no frame yet"


def test_an_image_of_another_type_is_the_reason() -> None:
    assert "frame.image must be a (height, width, 3) uint8 picture" in reason_of(
        np.zeros((240, 320), dtype=np.uint8)
    )


def test_a_grey_or_dark_image_is_the_reason() -> None:
    colours = draw_balls(GREEN, BLUE)
    grey = np.repeat(colours.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    assert reason_of(grey) == "the picture is grey, and the markers are known by their colours"
    assert reason_of((colours * 0.05).astype(np.uint8)) == "the picture is dark"


@pytest.mark.parametrize(
    ("balls", "why"),
    [
        ((BLUE,), "no green ball (marker 1)"),
        ((GREEN,), "no blue ball (marker 2)"),
        ((), "no green ball (marker 1) and no blue ball (marker 2)"),
        ((GREEN, ("blue", 318.0, 120.0, 14.0)), "no blue ball (marker 2)"),
    ],
)
def test_a_marker_outside_the_image_is_named(
    balls: tuple[tuple[str, float, float, float], ...], why: str
) -> None:
    assert (
        reason_of(draw_balls(("red", 30.0, 30.0, 9.0), *balls)) == f"the picture shows {why} whole"
    )


def test_the_number_of_detected_balls_of_one_colour_is_given() -> None:
    look = MarkerAppearance("red", "red", 12.0, 10.0)
    one = draw_balls(("red", 80.0, 100.0, 18.0))
    assert reason_of(one, look) == "of two red balls the picture shows 1 whole"


def test_balls_with_inconsistent_sizes_are_the_reason_with_their_sizes() -> None:
    why = reason_of(draw_balls(("green", 80.0, 100.0, 40.0), BLUE))
    assert why == (
        "the green and the blue ball have radii of 40 and 14 px, "
        "which do not fit radius_1 3.5 mm and radius_2 3.5 mm"
    )


def test_a_camera_of_points_names_the_lost_marker() -> None:
    def without_second(frame: Frame) -> Frame:
        assert frame.points is not None
        return replace(frame, points=np.array([frame.points[0], [np.nan, np.nan]]))

    assert reason(without_second) == "the camera does not see marker 2"


def test_a_tracker_without_a_reason_gives_a_general_message() -> None:
    class BlindTracker:
        def find(self, frame: Frame) -> Markers:
            return Markers(np.full((2, 2), np.nan), np.full(2, np.nan), np.zeros(2))

        def reset(self) -> None:
            pass

    assert reason(lambda frame: frame, BlindTracker()) == "both markers must be in the image"


def displace_some(fraction: float, seed: int, counts: list[bool]) -> Change:
    """Return a change that displaces a marker by 30-100 px in a fraction of the frames."""
    random = np.random.default_rng(seed)

    def change(frame: Frame) -> Frame:
        counts.append(bool(random.uniform() < fraction))
        angle, length_px = random.uniform(0.0, 2.0 * np.pi), random.uniform(30.0, 100.0)
        assert frame.points is not None
        points = frame.points.copy()
        if counts[-1]:
            points[random.integers(2)] += length_px * np.array([np.cos(angle), np.sin(angle)])
        return replace(frame, points=points)

    return change


@pytest.mark.parametrize("fraction", [0.03, 0.15])
def test_wrong_frames_are_left_out_and_counted(fraction: float) -> None:
    for seed in range(3):
        lab, wrong = make_laboratory(), list[bool]()
        camera = Changed(lab, displace_some(fraction, seed, wrong))
        target = teach(Plant(lab.rig.arm, camera, PointMarkers(), lab.rig.clock), frames=100)
        right = teach(lab.plant, frames=100)
        assert target.left_out == sum(wrong[-100:]) > 0
        np.testing.assert_allclose(target.points, right.points, atol=0.3)


@pytest.mark.parametrize("fraction", [0.5, 0.7])
def test_frames_of_which_many_are_wrong_teach_nothing(fraction: float) -> None:
    why = reason(displace_some(fraction, 1, []))
    assert "is detected at positions up to" in why and "px apart" in why


@pytest.mark.parametrize("joint", range(3))
def test_a_tool_that_moves_while_it_is_taught_is_the_reason(joint: int) -> None:
    lab = make_laboratory()
    frames, observation = TargetFrames(), lab.plant.read()
    for k in range(30):
        q = observation.q + np.eye(3)[joint] * (np.array([0.01, 0.01, 0.7]) if k < 3 else 0.0)
        frames.add(replace(observation, q=q, points=np.array([[1.0, 2.0], [30.0, 40.0]])))
    assert frames.describe_disagreement().startswith("the joints move by up to")
    frames.joints = [observation.q] * 30
    assert frames.describe_disagreement() == ""


def collect_frames(motion: Floats, noise: float, seed: int, markers: int = 2) -> TargetFrames:
    """Return frames of a tool at rest whose first markers move by `motion` (n,) px."""
    random, frames, direction = np.random.default_rng(seed), TargetFrames(), np.array([0.6, 0.8])
    q, pixels = np.zeros(3), np.array([[100.0, 50.0], [200.0, 80.0]])
    observation = make_observation(0, q, 0, 0, q, pixels)
    for moved in motion:
        points = observation.points + random.normal(0.0, noise, (2, 2))
        points[:markers] += moved * direction
        frames.add(replace(observation, points=points))
    return frames


def breathe(amplitude: float, period: float, phase: float) -> Floats:
    """Return the motion of 300 frames at 60 frames/s, px."""
    return amplitude * np.sin(2.0 * np.pi * np.arange(300) / 60.0 / period + phase)


@given(st.floats(2.0, 50.0), st.floats(2.0, 5.0), st.floats(0.0, 6.3), st.floats(0.0, 0.5))
def test_a_port_that_moves_with_the_breath_is_named_with_its_amplitude(
    amplitude: float, period: float, phase: float, noise: float
) -> None:
    frames = collect_frames(breathe(amplitude, period, phase), noise, 1)
    assert frames.compute_target(0).swing_px == pytest.approx(amplitude, rel=0.35)
    why = frames.describe_disagreement()
    assert not why or "port move with the breath" in why
    assert why or amplitude < 4.0


@given(st.floats(0.0, 2.0), st.integers(1, 400), st.integers(0, 1000))
def test_noise_of_the_markers_is_no_motion_of_the_port(noise: float, count: int, seed: int) -> None:
    assert collect_frames(np.zeros(count), noise, seed).compute_target(0).swing_px == 0.0


def test_one_marker_that_moves_is_no_motion_of_the_port() -> None:
    frames = collect_frames(breathe(20.0, 4.0, 0.0), 0.1, 1, markers=1)
    assert "marker 1 is detected at positions" in frames.describe_disagreement()


@pytest.mark.parametrize("swing_px", [0.0, 3.0])
def test_a_stop_mentions_the_motion_that_the_target_was_taught_with(swing_px: float) -> None:
    lab = make_laboratory()
    points = lab.target.points + np.array([[25.0, 0.0], [0.0, 0.0]])
    target = replace(lab.target, points=points, swing_px=swing_px)
    lab.plant.enable()
    for tick in servo_ticks(lab.plant, lab.servo(), target, 4.0):
        if tick.state.phase is Phase.PAUSED:
            break
    assert tick.state.cause is Cause.IMPLAUSIBLE
    assert ("both markers moved by ±3.0 px" in tick.state.text) == (swing_px > 0.0)
