"""Disturbances that a servo may fail to notice do to the frames what they say: nothing before their
time, and afterwards what they leave."""

from typing import NamedTuple

import numpy as np
import pytest

from rcmservo.interfaces import Command, Floats, Frame
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.sim.camera_model import Optics
from rcmservo.tracking import ColourMarkers

AT, OVER = 0.2, 0.7
"""s between which they act."""

UNDONE = [
    "freeze:at=0.2,for=0.5",
    "freeze:at=0.2,for=0.5,marker=2",
    "decoy:at=0.2,for=0.5,every=2,marker=2",
    "decoy:at=0.2,for=0.5,px=0,speed=40",
    "camera_clock:at=0.2,for=0.5,of=exposures,s=0.03",
    "camera_clock:at=0.2,for=0.5,of=exposures",
]
"""After these all is as before."""

STAYING = [
    "camera_pan:at=0.2,for=0.5,px=20",
    "camera_roll:at=0.2,for=0.5,deg=10",
    "camera_dolly:at=0.2,for=0.5,mm=-10",
    "camera_zoom:at=0.2,share=0.05",
]
"""After these the camera stays as it is then."""


class Look(NamedTuple):
    """One frame, and what is true of it."""

    time: float
    """s from the begin to the exposure, as it really was."""
    frame: Frame
    off: Floats
    """(2, 2) px from where the first camera would have seen the markers."""
    optics: Optics
    """The camera as it is."""


def looks(text: str, seconds: float = 1.0) -> list[Look]:
    """What a camera without noise shows of a tool that moves all the time."""
    rig = Rig(1, RigSettings(point_noise=0.0), False, [Disturbance.parse(text)])
    first, found = rig.scene.optics, list[Look]()
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
            seen = first.project(rig.truth.markers(true))
            assert frame.points is not None
            time = (true - began) * 1e-9
            found.append(Look(time, frame, frame.points - seen, rig.scene.optics))
    return found


def during(seen: list[Look]) -> list[Look]:
    return [look for look in seen if AT <= look.time < OVER]


def far(seen: list[Look], i: int) -> Floats:
    """How far off marker i, from 0, is in each frame, px."""
    return np.array([np.linalg.norm(look.off[i]) for look in seen])


@pytest.mark.parametrize("text", [*UNDONE, *STAYING])
def test_nothing_is_wrong_before_its_time_and_something_is_in_it(text: str) -> None:
    seen = looks(text)
    before = [look for look in seen if look.time < AT]
    assert len(before) > 8
    assert max(far(before, 0).max(), far(before, 1).max()) < 1e-9
    apart = [look.frame.exposure - round(look.frame.number * 1e9 / 60) for look in during(seen)]
    assert any(apart) or max(far(during(seen), 0).max(), far(during(seen), 1).max()) > 1.0


@pytest.mark.parametrize("text", UNDONE)
def test_nothing_is_wrong_any_more_when_what_can_be_undone_is_over(text: str) -> None:
    after = [look for look in looks(text) if look.time >= OVER + 0.05]
    assert len(after) > 8
    assert max(far(after, 0).max(), far(after, 1).max()) < 1e-9
    assert all(look.frame.exposure == round(look.frame.number * 1e9 / 60) for look in after)


@pytest.mark.parametrize("text", STAYING)
def test_a_camera_that_was_moved_slowly_or_zoomed_stays_as_it_is_then(text: str) -> None:
    seen = looks(text)
    after = [look.optics for look in seen if look.time >= OVER]
    assert len({id(optics) for optics in after}) == 1
    assert min(far(seen[-5:], 0).max(), far(seen[-5:], 1).max()) > 0.5


def test_a_frozen_picture_shows_the_same_in_frames_whose_numbers_and_times_go_on() -> None:
    seen = during(looks("freeze:at=0.2,for=0.5"))
    assert len({look.frame.points.tobytes() for look in seen if look.frame.points is not None}) == 1
    assert np.all(np.diff([look.frame.number for look in seen]) == 1)
    assert np.ptp(np.diff([look.frame.exposure for look in seen])) <= 1
    assert np.all(np.diff(far(seen, 0)) > 0.0)


@pytest.mark.parametrize("marker", [1, 2])
def test_one_frozen_marker_stays_where_it_is_seen_and_the_other_moves_on(marker: int) -> None:
    seen = during(looks(f"freeze:at=0.2,for=0.5,marker={marker}"))
    places = np.array([look.frame.points for look in seen])
    assert np.ptp(places[:, marker - 1], axis=0).max() < 1e-9
    assert far(seen, 2 - marker).max() < 1e-9
    assert far(seen, marker - 1)[-1] > 1.0


def test_a_marker_that_flickers_is_false_in_every_second_frame() -> None:
    seen = during(looks("decoy:at=0.2,for=0.5,every=2,marker=2,px=30"))
    assert far(seen, 0).max() < 1e-9
    halves = far(seen[::2], 1), far(seen[1::2], 1)
    right, wrong = sorted(halves, key=np.max)
    assert right.max() < 1e-9
    assert np.allclose(wrong, 30.0)


def test_a_decoy_slides_away_from_the_true_marker_in_one_direction() -> None:
    seen = during(looks("decoy:at=0.2,for=0.5,px=0,speed=40,marker=2"))
    assert far(seen, 0).max() < 1e-9
    assert np.allclose(far(seen, 1), [40.0 * (look.time - AT) for look in seen], atol=1e-6)
    ways = np.array([look.off[1] for look in seen[1:]]) / far(seen[1:], 1)[:, None]
    assert np.ptp(ways, axis=0).max() < 1e-6


def test_a_decoy_that_slides_out_of_the_picture_is_seen_no_more() -> None:
    last = looks("decoy:at=0,px=0,speed=1000", 1.5)[-1]
    assert last.frame.points is not None
    assert list(np.isnan(last.frame.points).all(axis=1)) == [True, False]


def test_a_pan_moves_the_picture_at_its_speed() -> None:
    seen = during(looks("camera_pan:at=0.2,for=0.5,px=20"))
    wanted = np.array([40.0 * (look.time - AT) for look in seen])
    for i in range(2):
        assert np.all(np.abs(far(seen, i) - wanted) <= 0.2 * wanted + 1e-6)


def test_a_camera_that_rolls_turns_about_its_line_of_sight_at_its_speed() -> None:
    seen = looks("camera_roll:at=0.2,for=0.5,deg=10")
    first, last = seen[0].optics, seen[-1].optics
    turn = last.rotation @ first.rotation.T
    assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) == pytest.approx(10.0)
    assert np.allclose(last.position, first.position)


def test_a_dolly_moves_the_camera_along_its_line_of_sight_by_so_many_mm() -> None:
    seen = looks("camera_dolly:at=0.2,for=0.5,mm=8")
    first, last = seen[0].optics, seen[-1].optics
    assert np.allclose(last.position - first.position, 8.0 * first.rotation[2])
    assert np.allclose(last.rotation, first.rotation)


def test_a_zoom_changes_the_focal_length_at_one_moment() -> None:
    seen = looks("camera_zoom:at=0.2,share=0.05")
    focal = np.array([look.optics.focal / seen[0].optics.focal for look in seen])
    assert np.all((np.abs(focal - 1.05) < 1e-9) == [look.time >= AT for look in seen])


@pytest.mark.parametrize("s", [0.03, -0.03])
def test_of_clocks_that_are_apart_only_exposures_are_told_wrongly(s: float) -> None:
    for look in during(looks(f"camera_clock:at=0.2,for=0.5,of=exposures,s={s}"))[2:-2]:
        true = round(look.frame.number * 1e9 / 60)
        assert look.frame.exposure - true == round(s * 1e9)
        assert look.frame.arrival - true == 22_000_000


@pytest.mark.parametrize("s", [0.03, -0.03])
def test_a_step_of_the_cameras_clock_shifts_both_its_stamps(s: float) -> None:
    for look in during(looks(f"camera_clock:at=0.2,for=0.5,s={s}"))[2:-2]:
        true = round(look.frame.number * 1e9 / 60)
        assert look.frame.exposure - true == round(s * 1e9)
        assert look.frame.arrival - look.frame.exposure == 22_000_000


def pictures(text: str, *moments: float) -> tuple[Rig, list[Frame]]:
    """Frames with pictures at so many s after the begin, of a tool that stands still."""
    rig = Rig(2, pictures=True, disturbances=[Disturbance.parse(text)])
    rig.begin()
    began, frames = rig.clock.now(), list[Frame]()
    for moment in moments:
        rig.clock.wait_until(began + round(moment * 1e9))
        frame = rig.camera.latest()
        assert frame is not None
        frames.append(frame)
    return rig, frames


def test_a_frozen_picture_is_the_same_down_to_its_noise() -> None:
    _, (before, first, *others) = pictures("freeze:at=0.1", 0.1, 0.15, 0.2, 0.3)
    assert not np.array_equal(before.image, first.image)
    assert all(np.array_equal(first.image, other.image) for other in others)
    assert others[-1].number > first.number


@pytest.mark.parametrize(
    ("text", "distance"),
    [("decoy:px=0,speed=100,marker=2", 40.0), ("freeze:marker=2", 0.0)],
)
def test_a_decoy_is_found_in_pictures_where_it_should_be(text: str, distance: float) -> None:
    tracker = ColourMarkers()
    rig, frames = pictures(text, 0.1, 0.422)
    found = [tracker.find(frame).points for frame in frames][-1]
    true = rig.truth.pixels(rig.truth.joints_at(frames[-1].exposure))
    off = np.linalg.norm(found - true, axis=1)
    assert off[0] < 1.0
    assert off[1] == pytest.approx(distance, abs=2.5)
