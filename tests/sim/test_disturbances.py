"""What goes wrong in the simulated laboratory does so where it would, and the servo answers as the
table says."""

import contextlib
import math
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_quiet_disturbances import STAYING, UNDONE

from conftest import first_quick, frozen, laboratory, random_from, seeds, taught
from rcmservo.errors import BadInput
from rcmservo.guard.causes import Cause
from rcmservo.guard.states import SLOW_SHARE, Phase, Request
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Command, Dropped, Floats, Frame, Observation
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.servo.servo import Servo
from rcmservo.servo.state import State
from rcmservo.sim import Disturbance, Killed, Rig
from rcmservo.sim.disturbances import KINDS, causes_of, describe, random_disturbances
from rcmservo.sim.disturbances.old_names import OLD
from rcmservo.sim.disturbances.smoke_and_blood import Smoke
from rcmservo.sim.scripted_operator import ScriptedPerson, attended
from rcmservo.tracking import ColourMarkers, PointMarkers

ONSET = 1.3
"""s after the start: the servo has explored by then and is on its way."""

STOPPED = Phase.HOLD, Phase.PAUSED, Phase.FAULT
ZERO = 0.1
"""s within which a servo that holds or pauses commands no motion any more."""


def rig_with(text: str, seed: int = 1, pictures: bool = False) -> Rig:
    return Rig(seed, pictures=pictures, disturbances=parsed(text))


def tip(rig: Rig, q: Floats) -> Floats:
    """Marker 1 (3,) mm at the joints q (3,)."""
    return rig.scene.body.points(q)[0]


def parsed(text: str) -> list[Disturbance]:
    return [Disturbance.parse(one) for one in text.split()]


def kind_of(text: str) -> str:
    return Disturbance.parse(text).kind


@dataclass
class Run:
    """A run with disturbances, up to its end."""

    rig: Rig
    ticks: list[Tick]

    def after(self, time: float = ONSET) -> list[Tick]:
        return [tick for tick in self.ticks if tick.time >= time * 1e9]

    def stop(self) -> Tick:
        """The first tick after the onset at which the servo stops."""
        return next(tick for tick in self.after() if tick.state.phase in STOPPED)

    def stops(self) -> bool:
        return any(tick.state.phase in STOPPED for tick in self.ticks)

    def causes(self) -> set[Cause]:
        return {tick.state.cause for tick in self.after()} - {Cause.NONE}


@lru_cache(maxsize=64)
def running(text: str, seed: int = 1, seconds: float = ONSET + 1.5) -> Run:
    rig = rig_with(text, seed)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock, lambda: not rig.disk_full())
    target = taught(rig, plant)
    servo = Servo(rig.settings.mechanism, rig.settings.tool)
    servo.warm_up()
    rig.begin()
    ticks: list[Tick] = []
    with contextlib.suppress(Killed):
        ticks.extend(run(plant, servo, target, seconds))
    return Run(rig, ticks)


FRAME, TICK = 1 / 60, 0.01
SEEN = 0.022 + FRAME + TICK
"""s until a tick knows what has happened before the camera: the frame's exposure, its way, and the
wait for both."""

STALE = 3.0 * FRAME + TICK

TABLE: dict[str, tuple[Phase, Cause, float]] = {
    "occlusion:at=1.3,for=0.3": (Phase.HOLD, Cause.MARKERS_LOST, SEEN),
    "nan_points:at=1.3,for=0.3": (Phase.HOLD, Cause.MARKERS_LOST, SEEN),
    "occlusion:at=1.3,for=0.5,by=blood": (Phase.HOLD, Cause.MARKERS_LOST, SEEN + 0.07),
    "swap:at=1.3": (Phase.PAUSED, Cause.SWAPPED, SEEN + 2 * FRAME),
    "decoy:at=1.3": (Phase.PAUSED, Cause.SURPRISED, SEEN + 2 * FRAME),
    "decoy:at=1.3,marker=2,px=25": (Phase.PAUSED, Cause.SURPRISED, SEEN + 2 * FRAME),
    "camera_pan:at=1.3": (Phase.PAUSED, Cause.CAMERA_MOVED, SEEN + 2 * FRAME),
    "camera_roll:at=1.3": (Phase.PAUSED, Cause.CAMERA_MOVED, SEEN + 2 * FRAME),
    "camera_roll:at=1.3,deg=-30": (Phase.PAUSED, Cause.CAMERA_MOVED, SEEN + 2 * FRAME),
    "relocate:at=1.3": (Phase.PAUSED, Cause.CAMERA_MOVED, SEEN + 2 * FRAME),
    "latency:at=1.3,for=0.5": (Phase.HOLD, Cause.STALE, STALE),
    "frame_drop:at=1.3,share=1": (Phase.HOLD, Cause.STALE, STALE),
    "frame_order:at=1.3,for=0.3": (Phase.HOLD, Cause.FRAMES_NOT_NEW, STALE),
    "camera_clock:at=1.3,for=0.3,s=3600": (Phase.HOLD, Cause.FRAMES_CLOCK, STALE),
    "camera_clock:at=1.3,for=0.3,s=-3600": (Phase.HOLD, Cause.FRAMES_CLOCK, STALE),
    "corrupt:at=1.3,for=0.3,what=none": (Phase.HOLD, Cause.FRAMES_DAMAGED, STALE),
    "corrupt:at=1.3,for=0.3,what=size": (Phase.HOLD, Cause.FRAMES_DAMAGED, STALE),
    "encoder_nan:at=1.3,axis=3": (Phase.FAULT, Cause.JOINTS_NOT_FINITE, TICK),
    "encoder:at=1.3,factor=1,offset=5,axis=2": (Phase.FAULT, Cause.NOT_FOLLOWING, TICK),
    "encoder:at=1.3,factor=1,offset=5,axis=3": (Phase.FAULT, Cause.NOT_FOLLOWING, TICK),
    "arm_silent:at=1.3": (Phase.FAULT, Cause.ARM_SILENT, 0.06),
    "arm_clock:at=1.3": (Phase.FAULT, Cause.DRIVE_OFF, TICK),
    "arm_clock:at=1.3,s=3600": (Phase.FAULT, Cause.DRIVE_OFF, TICK),
    "drive_off:at=1.3": (Phase.FAULT, Cause.DRIVE_OFF, TICK),
    "stall:at=1.3,for=0.06,where=tick": (Phase.FAULT, Cause.DRIVE_OFF, 0.06 + TICK),
    "stall:at=1.3": (Phase.FAULT, Cause.DRIVE_OFF, 0.5 + TICK),
    "disk_full:at=1.3": (Phase.PAUSED, Cause.NOT_RECORDED, TICK),
}
"""What happens while the servo is on its way, and what must follow within so many s."""

FOLLOWING = [
    f"gain:at=1.3,axis={axis},factor={factor}" for factor in (0, -1, 3) for axis in (1, 2, 3)
]
FOLLOWING += [f"encoder:at=1.3,axis={axis}" for axis in (1, 2, 3)]


@pytest.mark.parametrize("text", TABLE)
def test_the_servo_answers_with_the_phase_and_cause_of_the_table_within_its_bound(
    text: str,
) -> None:
    phase, cause, bound = TABLE[text]
    done = running(text)
    stop = done.stop()
    assert (stop.state.phase, stop.state.cause) == (phase, cause)
    assert stop.time * 1e-9 <= ONSET + bound + 1e-6
    assert done.causes() <= causes_of(kind_of(text))


ONE_LOST = {
    "occlusion:at=1.3,marker=1": Cause.WITHOUT_MARKER_1,
    "occlusion:at=1.3,for=0.3,marker=2": Cause.WITHOUT_MARKER_2,
    "occlusion:at=1.3,for=0.017,marker=2": Cause.WITHOUT_MARKER_2,
    "corrupt:at=1.3,for=0.3,what=half": Cause.WITHOUT_MARKER_2,
}


@pytest.mark.parametrize("text", ONE_LOST)
def test_one_lost_marker_slows_the_tool_while_the_other_tells_the_pose_and_it_gets_there(
    text: str,
) -> None:
    done = running(text, seconds=12.0)
    slow = [tick for tick in done.ticks if tick.state.cause is ONE_LOST[text]]
    assert not done.stops() and done.causes() == {ONE_LOST[text]}
    assert slow[0].time * 1e-9 <= ONSET + SEEN + 1e-6
    assert all(tick.state.mode.share == SLOW_SHARE for tick in slow)
    end = done.ticks[-1].state
    assert end.decision.left < 0.1
    assert np.linalg.norm(end.p1 - tip(done.rig, end.target.q)) < 1.0


@pytest.mark.parametrize(
    "moves", ["camera_pan:at=1.6", "camera_pan:at=1.6,for=4.5,px=45", "freeze:at=1.5"]
)
def test_while_one_marker_is_lost_the_other_tells_that_the_camera_moves_or_stands_still(
    moves: str,
) -> None:
    done = running(f"occlusion:at=1.3,marker=1 {moves}", seconds=5.0)
    stop = done.stop()
    assert stop.state.phase is Phase.PAUSED
    wanted = (Cause.FROZEN, Cause.SURPRISED) if "freeze" in moves else (Cause.SURPRISED,)
    assert stop.state.cause in wanted
    assert np.linalg.norm(done.ticks[-1].state.p1 - stop.state.p1) < 2.0


@pytest.mark.parametrize("text", [*TABLE, *FOLLOWING])
def test_a_hold_or_pause_brings_the_command_to_zero_in_100_ms_and_a_fault_at_once(
    text: str,
) -> None:
    done = running(text)
    stop = done.stop()
    later = stop.time + (0 if stop.state.phase is Phase.FAULT else ZERO * 1e9)
    held = [tick for tick in done.ticks if tick.time >= later and tick.state.phase in STOPPED]
    assert held or stop.state.phase is not Phase.FAULT
    assert all(not tick.state.command.rates.any() for tick in held)
    assert stop.state.phase is not Phase.FAULT or not stop.state.command.enabled


@pytest.mark.parametrize("text", FOLLOWING)
def test_an_axis_that_does_not_do_as_told_is_a_fault_before_it_is_two_degrees_or_3_mm_off(
    text: str,
) -> None:
    done = running(text)
    stop = done.stop()
    assert (stop.state.phase, stop.state.cause) == (Phase.FAULT, Cause.NOT_FOLLOWING)
    assert np.all(
        np.abs(stop.seen.q - stop.state.watch.reached)
        <= [math.radians(2.0), math.radians(2.0), 3.0]
    )


PAUSES = "occlusion:at=1.3"
"""Ends in a pause, 1 s later."""

CREEP = [
    "creep:at=4,axis=1,speed=0.2",
    "creep:at=4,axis=2,speed=-1",
    "creep:at=4,axis=3,speed=0.1",
    "creep:at=4,axis=3,speed=-2",
]


@pytest.mark.parametrize("text", CREEP)
def test_a_drive_that_creeps_while_nothing_is_commanded_is_a_fault_however_slowly_it_does(
    text: str,
) -> None:
    ticks = left_alone(f"{PAUSES} {text}", 11.0)
    seen, state = next(tick for tick in ticks if tick[1].phase is Phase.FAULT)
    assert state.cause is Cause.CREEPS
    assert "at rest it should stay within" in state.words
    assert f"joint {text.partition('axis=')[2][0]} " in state.words
    assert np.all(np.abs(seen.q - state.watch.rest) <= 1.1 * np.array(Thresholds().following))


def test_a_drive_may_rest_for_as_long_as_it_likes() -> None:
    *_, (_, last) = left_alone(PAUSES, 30.0)
    assert last.phase is Phase.PAUSED


def left_alone(text: str, seconds: float) -> Iterator[tuple[Observation, State]]:
    """Observation and state of every tick of a run in which nobody answers to a pause."""
    lab = laboratory(disturbances=parsed(text))
    lab.rig.begin()
    return lab.run(lab.servo(), seconds)


def test_every_kind_is_brought_about_in_these_tests() -> None:
    elsewhere = {"jitter", "kill"}
    frame_by_frame = {kind_of(text) for text in (*UNDONE, *STAYING)}
    tested = {kind_of(text) for text in (*TABLE, *FOLLOWING, *CREEP)} | elsewhere | frame_by_frame
    assert tested == set(KINDS)


def test_smoke_that_comes_and_goes_is_a_hold_for_lost_markers_until_it_has_gone() -> None:
    done = running("occlusion:at=1.3,for=0.9,by=smoke", seconds=5.0)
    assert done.stop().state.phase is Phase.HOLD
    assert Cause.MARKERS_LOST in done.causes() <= causes_of("occlusion")
    assert done.ticks[-1].state.phase is Phase.SERVO


def test_latency_within_100_ms_is_compensated_and_beyond_it_the_servo_holds() -> None:
    assert not running("latency:at=1.3,s=0.02").stops()
    late = running("latency:at=1.3,s=0.15")
    assert Cause.LATE in late.causes() <= causes_of("latency")
    assert late.ticks[-1].state.phase is Phase.PAUSED


def test_frames_that_come_later_by_chance_are_held_against_and_named() -> None:
    done = running("latency:at=1.3,for=0.6,s=0,jitter=0.3", seconds=4.5)
    assert {Cause.LATE, Cause.STALE} <= done.causes() <= causes_of("latency")
    assert done.ticks[-1].state.phase is Phase.SERVO


def test_of_frames_out_of_order_the_older_is_dropped_and_the_tool_goes_on_at_most_slowly() -> None:
    done = running("frame_order:at=1.3,for=0.5,what=swapped")
    numbers = [tick.seen.frame for tick in done.ticks]
    assert numbers == sorted(numbers)
    assert any(tick.seen.dropped is Dropped.NOT_NEW for tick in done.ticks)
    assert done.causes() == {Cause.AGEING}
    assert not done.stops()


def test_ticks_a_little_late_are_warned_of_and_no_more() -> None:
    done = running("jitter:at=1.3,s=0.008")
    assert done.causes() == {Cause.LATE_TICK}
    assert not done.stops()


@pytest.mark.parametrize("text", ["jitter:at=1.3,for=0.5,s=0.03", "stall:at=1.3,for=0.03"])
def test_late_ticks_are_named_as_such(text: str) -> None:
    assert running(text).causes() <= causes_of(kind_of(text))


def test_one_tick_that_takes_30_ms_longer_is_a_warning() -> None:
    done = running("stall:at=1.3,for=0.03,where=tick")
    assert done.causes() == {Cause.LATE_TICK}
    assert not done.stops()


def test_when_the_process_is_killed_the_arm_stops_by_itself_within_50_ms_of_its_last_command() -> (
    None
):
    done = running("kill:at=1.304")
    last, arm = done.ticks[-1], done.rig.truth.arm
    assert last.time == pytest.approx(ONSET * 1e9)
    assert last.state.command.rates.any()
    done.rig.let_pass(last.seen.now + 49_000_000)
    assert arm.watchdog.enabled
    done.rig.let_pass(last.seen.now + 52_000_000)
    assert not arm.watchdog.enabled
    q = arm.q_true
    done.rig.let_pass(last.seen.now + 300_000_000)
    assert np.all(np.abs(arm.q_true - q) < [1e-3, 1e-3, 0.1])


def test_a_silent_arm_hears_nothing_stops_by_itself_and_tells_so_when_it_answers_again() -> None:
    rig = rig_with("arm_silent:at=0.1,for=0.1")
    rig.begin()
    rig.arm.enable()
    told: list[bool] = []
    true: list[bool] = []
    for k in range(25):
        rig.clock.wait_until(rig.clock.now() + 10_000_000)
        now = rig.clock.now()
        rig.arm.apply(Command(k, now, now + 30_000_000, np.array([0.1, 0.0, 0.0]), True))
        told.append(rig.arm.measure().enabled)
        true.append(rig.truth.arm.watchdog.enabled)
    assert true == [True] * 12 + [False] * 13
    assert told == [True] * 19 + [False] * 6


def test_an_emergency_stop_leaves_the_drive_off_until_it_is_released() -> None:
    rig = rig_with("drive_off:at=0.1,for=0.2")
    rig.begin()
    enabled: list[bool] = []
    for wait in (50_000_000, 100_000_000, 200_000_000):
        rig.clock.wait_until(rig.clock.now() + wait)
        rig.arm.enable()
        rig.clock.wait_until(rig.clock.now() + 2_000_000)
        enabled.append(rig.arm.measure().enabled)
    assert enabled == [True, False, True]


# ---------------------------------------------------------------- the kit itself


@pytest.mark.parametrize("pictures", [False, True])
def test_a_rig_whose_disturbance_never_comes_is_the_same_as_one_without_bit_for_bit(
    pictures: bool,
) -> None:
    plain, late = (
        Rig(3, pictures=pictures),
        Rig(3, pictures=pictures, disturbances=[Disturbance("decoy", at=1e3)]),
    )
    late.begin()
    for rig in (plain, late):
        rig.arm.enable()
    for k in range(20 if pictures else 100):
        frames: list[Frame | None] = []
        for rig in (plain, late):
            rig.clock.wait_until(rig.clock.now() + 10_000_000)
            frames.append(rig.camera.latest())
        assert frozen(frames[0]) == frozen(frames[1]), k
        assert frozen(plain.arm.measure()) == frozen(late.arm.measure())


def test_nothing_goes_wrong_before_the_run_begins() -> None:
    rig = rig_with("occlusion arm_silent encoder_nan disk_full kill")
    rig.show_target()
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    teach(plant, frames=5)
    assert not rig.disk_full()
    rig.begin()
    assert rig.disk_full()
    with pytest.raises(Killed):
        rig.clock.wait_until(rig.clock.now() + 10_000_000)


@settings(max_examples=8)
@given(seeds)
def test_the_same_seed_and_disturbances_give_the_same_run(seed: int) -> None:
    text = " ".join(map(str, random_disturbances(random_from(seed), 1.0)))
    first, again = (running(text, seconds=1.2) for _ in range(2))
    assert [frozen((tick.seen, tick.state.command)) for tick in first.ticks] == [
        frozen((tick.seen, tick.state.command)) for tick in again.ticks
    ]


@given(seeds, st.booleans())
def test_a_disturbance_is_written_as_it_is_read_and_survives_a_pickle(
    seed: int, pictures: bool
) -> None:
    chosen = random_disturbances(random_from(seed), 20.0, pictures)
    assert 1 <= len(chosen) <= 3
    for disturbance in chosen:
        assert (
            Disturbance.parse(str(disturbance))
            == disturbance
            == pickle.loads(pickle.dumps(disturbance))
        )
        assert disturbance.at <= 20.0
        assert KINDS[disturbance.kind].pictures or not pictures


@given(
    st.one_of(
        st.text(max_size=30),
        st.builds("{}:{}".format, st.sampled_from([*KINDS, *OLD]), st.text(max_size=20)),
    )
)
def test_any_text_is_a_disturbance_or_refused_with_a_sentence(text: str) -> None:
    try:
        disturbance = Disturbance.parse(text)
    except BadInput as error:
        assert "must be" in str(error)
    else:
        assert math.isfinite(disturbance.at)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("marker_loss:at=1,marker=2", "occlusion:at=1,marker=2"),
        ("smoke:at=1,for=2", "occlusion:at=1,for=2,by=smoke"),
        ("false_marker:at=1,px=20", "decoy:at=1,px=20"),
        ("slide:at=1,speed=9", "decoy:at=1,px=0,speed=9"),
        ("pan", "camera_pan:for=4.5,px=45"),
        ("rolling:for=2,speed=-3", "camera_roll:for=2,deg=-6"),
        ("dolly:at=1,for=4,speed=-2", "camera_dolly:at=1,for=4,mm=-8"),
        ("delay:s=0.3", "latency:s=0,jitter=0.3"),
        ("clock_step:at=1,for=2", "camera_clock:at=1,for=2,s=3600"),
        ("axis_reversed:axis=2", "gain:axis=2,factor=-1"),
        ("overrun", "stall:for=0.1,where=tick"),
        ("creep:axis=2", "creep:axis=2"),
    ],
)
def test_an_old_name_is_read_in_studies_and_records_and_elsewhere_its_new_spelling_is_told(
    old: str, new: str
) -> None:
    assert Disturbance.read(old) == Disturbance.parse(new)
    if old != new:
        with pytest.raises(BadInput) as refused:
            Disturbance.parse(old)
        spelling = str(refused.value).partition("written ")[2].partition(" now")[0]
        assert Disturbance.parse(spelling) == Disturbance.parse(new)


def test_each_old_name_is_read_and_none_is_a_kind_any_more() -> None:
    assert {Disturbance.read(name).kind for name in OLD} <= set(KINDS)
    assert not set(OLD) & set(KINDS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("occlusio", ["disturbance", "did you mean occlusion?"]),
        ("occlusion:at", ["occlusion", "'at'", "key=value"]),
        ("occlusion:at=nan", ["at", "a time in s"]),
        ("occlusion:at=-1", ["at", "a time in s"]),
        ("occlusion:at=1,at=2", ["at", "once"]),
        ("occlusion:for=0", ["for", "above 0"]),
        ("occlusion:for=inf", ["for", "at most"]),
        ("occlusion:axis=1", ["axis", "one of at, for, by, marker"]),
        ("occlusion:marker=3", ["marker", "from 0 to 2"]),
        ("occlusion:marker=0.5", ["marker", "a whole number"]),
        ("relocate:for=2", ["relocate", "for", "left out"]),
        ("camera_pan:for=-1", ["camera_pan", "for", "from 0 to"]),
        ("camera_pan:px=nan", ["px", "a number of px"]),
        ("corrupt:what=all", ["what", "size, half, noise, none"]),
    ],
)
def test_what_is_wrong_with_a_disturbance_is_said_with_its_key(
    text: str, words: Sequence[str]
) -> None:
    with pytest.raises(BadInput) as refused:
        Disturbance.parse(text)
    assert all(word in str(refused.value) for word in words)


def test_only_a_camera_without_pictures_can_be_given_points_that_are_not_finite() -> None:
    with pytest.raises(BadInput, match="nan_points"):
        rig_with("nan_points", pictures=True)


def test_every_kind_that_run_takes_is_described_in_a_line() -> None:
    lines = describe().splitlines()
    assert [line.split(":")[0] for line in lines] == [
        kind for kind in KINDS if kind != "nan_points"
    ]


def test_every_kind_has_causes_unless_nothing_is_left_to_name_them() -> None:
    assert {name for name in KINDS if not causes_of(name)} == {"kill"}


# ---------------------------------------------------------------- pictures


def pictured(
    text: str, seconds: float, seed: int = 2, tracker: ColourMarkers | None = None
) -> tuple[Rig, Frame]:
    """The newest frame so many s after the begin, with an earlier one shown to the tracker."""
    rig = rig_with(text, seed, pictures=True)
    first = rig.camera.latest()
    assert first is not None
    if tracker is not None:
        tracker.find(first)
    rig.begin()
    rig.clock.wait_until(rig.clock.now() + round(seconds * 1e9))
    frame = rig.camera.latest()
    assert frame is not None
    return rig, frame


def off(rig: Rig, frame: Frame, tracker: ColourMarkers) -> np.ndarray:
    """How far the markers are found from where they are, px; NaN where they are lost."""
    true = rig.truth.pixels(rig.truth.joints_at(frame.exposure))
    return np.linalg.norm(tracker.find(frame).points - true, axis=1)


@pytest.mark.parametrize(
    ("marker", "lost"), [(0, [True, True]), (1, [True, False]), (2, [False, True])]
)
def test_a_lost_marker_is_not_in_the_picture_and_the_other_is_where_it_was(
    marker: int, lost: list[bool]
) -> None:
    tracker = ColourMarkers()
    miss = off(*pictured(f"occlusion:marker={marker}", 0.1, tracker=tracker), tracker)
    assert list(np.isnan(miss)) == lost
    assert np.all(miss[~np.isnan(miss)] < 1.0)


def test_swapped_markers_are_found_in_each_others_place() -> None:
    tracker = ColourMarkers()
    rig, frame = pictured("swap", 0.1)
    true = rig.truth.pixels(rig.truth.joints_at(frame.exposure))
    assert np.abs(tracker.find(frame).points - true[::-1]).max() < 1.0


@pytest.mark.parametrize("marker", [1, 2])
def test_a_false_marker_is_found_as_far_off_as_asked_for(marker: int) -> None:
    tracker = ColourMarkers()
    miss = off(*pictured(f"decoy:px=80,marker={marker}", 0.1), tracker)
    assert miss[marker - 1] == pytest.approx(80.0, abs=1.5)
    assert miss[2 - marker] < 1.0


@pytest.mark.parametrize("text", ["occlusion:for=4,by=smoke", "occlusion:for=4,by=blood"])
@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_no_marker_is_found_behind_dense_smoke_or_blood(text: str, seed: int) -> None:
    tracker = ColourMarkers()
    for seconds in (1.0, 2.5):
        assert np.isnan(off(*pictured(text, seconds, seed, tracker), tracker)).all()


def test_markers_are_found_again_when_smoke_and_blood_have_gone() -> None:
    tracker = ColourMarkers()
    assert np.all(
        off(*pictured("occlusion:for=0.5,by=smoke occlusion:for=0.5,by=blood", 0.6), tracker) < 1.0
    )


def test_smoke_comes_and_goes_by_degrees() -> None:
    smoke = Smoke((640, 480), 4.0, np.array([320.0, 240.0]), random_from(0))
    middle = [
        float(smoke.pane(time).opacity[60, 80]) for time in (0.0, 0.1, 0.2, 0.3, 2.0, 3.6, 3.8, 4.0)
    ]
    assert middle[0] == middle[-1] == 0.0
    assert middle[4] > 0.95
    assert np.all(np.diff(middle[:5]) > 0.0)
    assert np.all(np.diff(middle[4:]) < 0.0)


def test_a_picture_keeps_its_noise_and_its_size_behind_smoke() -> None:
    _, frame = pictured("occlusion:for=4,by=smoke", 2.0)
    assert frame.image is not None
    assert frame.image.shape == (480, 640, 3)
    assert frame.image.dtype == np.uint8
    assert np.abs(np.diff(frame.image[240].astype(float), axis=0)).mean() > 1.0


@pytest.mark.parametrize("what", ["size", "half", "noise", "none"])
def test_a_damaged_picture_is_dropped_or_tells_of_at_most_what_is_left(what: str) -> None:
    _, frame = pictured(f"corrupt:what={what}", 0.1)
    if what == "none":
        assert frame.image is None
        return
    assert frame.image is not None
    assert (frame.image.shape == (240, 320, 3)) == (what == "size")
    plain = Rig(2).camera.latest()
    assert plain is not None
    assert not np.array_equal(plain.image, frame.image)
    if what == "half":
        assert np.ptp(frame.image[-40:].astype(int)) <= 2


@pytest.mark.parametrize(
    "text",
    [
        "camera_pan:px=30",
        pytest.param("camera_roll:deg=20", marks=pytest.mark.slow),
        pytest.param("relocate", marks=pytest.mark.slow),
    ],
)
def test_a_camera_that_was_moved_sees_the_tool_where_its_new_optics_say(text: str) -> None:
    tracker = ColourMarkers()
    old = rig_with(text, 2, pictures=True).scene.optics
    rig, frame = pictured(text, 0.1)
    assert np.all(off(rig, frame, tracker) < 1.0)
    markers = rig.truth.markers(frame.exposure)
    jump = np.linalg.norm(rig.truth.optics.project(markers) - old.project(markers), axis=1)
    assert jump.max() > 5.0
    if text.startswith("camera_pan"):
        assert np.all(np.abs(jump - 30.0) < 8.0)


def test_a_person_counts_the_requests_that_led_on_apart_from_those_refused() -> None:
    rig = rig_with("occlusion:at=1.3,for=3.5")
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.show_target()
    target = teach(plant, frames=30)
    rig.go_home()
    rig.begin()
    person = ScriptedPerson(rig, plant, 9, frames=30)
    ticks = list(
        attended(rig, plant, Servo(rig.settings.mechanism, rig.settings.tool), target, 8.0, person)
    )
    answers = [tick.state.phase for tick in ticks if tick.request is Request.RESUME]
    assert answers == [Phase.PAUSED, Phase.PAUSED, Phase.ACQUIRE]
    assert (person.resumed, person.refused) == (1, 2)
