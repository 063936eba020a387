"""Disturbances and the phases and causes with which the servo responds to them."""

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
from test_quiet_disturbances import PERMANENT, TRANSIENT

from conftest import make_laboratory, make_random, mark_others_slow, seeds, snapshot, teach_target
from rcmservo import sim
from rcmservo.errors import BadInput
from rcmservo.interfaces import Command, DropReason, Floats, Frame, Observation
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import SLOW_SPEED_SCALE, Phase, Request
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.servo.state import State
from rcmservo.sim import Disturbance, Killed, Rig, RigSettings, SceneSettings
from rcmservo.sim.disturbances import (
    DISTURBANCE_KINDS,
    describe_kinds,
    expected_causes,
    sample_disturbances,
)
from rcmservo.sim.disturbances.effects.smoke_and_blood import Smoke
from rcmservo.sim.disturbances.old_names import OLD_NAMES
from rcmservo.sim.scripted_operator import ScriptedOperator, run_attended
from rcmservo.tracking import ColourMarkers, PointMarkers

ONSET = 1.3
"""Start (s) of the disturbances: the servo has explored and moves to the target."""

STOPPED = Phase.HOLD, Phase.PAUSED, Phase.FAULT
STOP_TIME = 0.1
"""Time (s) within which a holding or paused servo commands no motion."""


SMALL_IMAGES = RigSettings(width=320, height=240, scene=SceneSettings(focal=(250.0, 450.0)))
"""Settings of the default scenes in images of half the width and height."""


def rig_with(text: str, seed: int = 1, pictures: bool = False) -> Rig:
    chosen = SMALL_IMAGES if pictures else None
    return Rig(seed, chosen, pictures=pictures, disturbances=parse_all(text))


def marker_1(rig: Rig, q: Floats) -> Floats:
    """Return marker 1 (3,) mm at the joints q (3,)."""
    return rig.scene.body.points(q)[0]


def parse_all(text: str) -> list[Disturbance]:
    return [Disturbance.parse(item) for item in text.split()]


def kind_of(text: str) -> str:
    return Disturbance.parse(text).kind


@dataclass
class Run:
    """Run with disturbances, up to its end."""

    rig: Rig
    ticks: list[Tick]

    def after(self, time: float = ONSET) -> list[Tick]:
        return [tick for tick in self.ticks if tick.time >= time * 1e9]

    def stop(self) -> Tick:
        """Return the first tick after the onset at which the servo stops."""
        return next(tick for tick in self.after() if tick.state.phase in STOPPED)

    def stops(self) -> bool:
        return any(tick.state.phase in STOPPED for tick in self.ticks)

    def causes(self) -> set[Cause]:
        return {tick.state.cause for tick in self.after()} - {Cause.NONE}


WATCHED_S = ONSET + 0.9
"""Duration (s) of runs that stop within half a second and need not pause after a hold."""


@lru_cache(maxsize=64)
def run_disturbed(text: str, seed: int = 1, seconds: float = ONSET + 1.5) -> Run:
    rig = rig_with(text, seed)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock, lambda: not rig.disk_full())
    target = teach_target(rig, plant)
    servo = Servo(rig.settings.mechanism, rig.settings.tool)
    servo.warm_up()
    rig.begin()
    ticks: list[Tick] = []
    with contextlib.suppress(Killed):
        ticks.extend(servo_ticks(plant, servo, target, seconds))
    return Run(rig, ticks)


FRAME, TICK = 1 / 60, 0.01
VISION_LATENCY = 0.022 + FRAME + TICK
"""Time (s) until a tick knows an event in front of the camera: exposure, delay and two waits."""

STALE = 3.0 * FRAME + TICK

TABLE: dict[str, tuple[Phase, Cause, float]] = {
    "occlusion:at=1.3,for=0.3": (Phase.HOLD, Cause.MARKERS_LOST, VISION_LATENCY),
    "nan_points:at=1.3,for=0.3": (Phase.HOLD, Cause.MARKERS_LOST, VISION_LATENCY),
    "occlusion:at=1.3,for=0.5,by=blood": (Phase.HOLD, Cause.MARKERS_LOST, VISION_LATENCY + 0.07),
    "swap:at=1.3": (Phase.PAUSED, Cause.SWAPPED, VISION_LATENCY + 2 * FRAME),
    "decoy:at=1.3": (Phase.PAUSED, Cause.SURPRISED, VISION_LATENCY + 2 * FRAME),
    "decoy:at=1.3,marker=2,px=25": (Phase.PAUSED, Cause.SURPRISED, VISION_LATENCY + 2 * FRAME),
    "camera_pan:at=1.3": (Phase.PAUSED, Cause.CAMERA_MOVED, VISION_LATENCY + 2 * FRAME),
    "camera_roll:at=1.3": (Phase.PAUSED, Cause.CAMERA_MOVED, VISION_LATENCY + 2 * FRAME),
    "camera_roll:at=1.3,deg=-30": (Phase.PAUSED, Cause.CAMERA_MOVED, VISION_LATENCY + 2 * FRAME),
    "relocate:at=1.3": (Phase.PAUSED, Cause.CAMERA_MOVED, VISION_LATENCY + 2 * FRAME),
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
"""Disturbances on the path to the target, with the phase, the cause and the largest time (s) to
them."""

FOLLOWING = [
    f"gain:at=1.3,axis={axis},factor={factor}" for factor in (0, -1, 3) for axis in (1, 2, 3)
]
FOLLOWING += [f"encoder:at=1.3,axis={axis}" for axis in (1, 2, 3)]


@pytest.mark.parametrize("text", TABLE)
def test_the_servo_responds_with_the_tables_phase_and_cause_in_time(
    text: str,
) -> None:
    phase, cause, bound = TABLE[text]
    result = run_disturbed(text, seconds=WATCHED_S)
    stop = result.stop()
    assert (stop.state.phase, stop.state.cause) == (phase, cause)
    assert stop.time * 1e-9 <= ONSET + bound + 1e-6
    assert result.causes() <= expected_causes(kind_of(text))


ONE_LOST = {
    "occlusion:at=1.3,marker=1": Cause.WITHOUT_MARKER_1,
    "occlusion:at=1.3,for=0.3,marker=2": Cause.WITHOUT_MARKER_2,
    "occlusion:at=1.3,for=0.017,marker=2": Cause.WITHOUT_MARKER_2,
    "corrupt:at=1.3,for=0.3,what=half": Cause.WITHOUT_MARKER_2,
}


@pytest.mark.parametrize("text", ONE_LOST)
def test_one_lost_marker_slows_the_tool_and_the_other_gives_the_pose(
    text: str,
) -> None:
    result = run_disturbed(text, seconds=9.0)
    slow = [tick for tick in result.ticks if tick.state.cause is ONE_LOST[text]]
    assert not result.stops() and result.causes() == {ONE_LOST[text]}
    assert slow[0].time * 1e-9 <= ONSET + VISION_LATENCY + 1e-6
    assert all(tick.state.mode.speed_scale == SLOW_SPEED_SCALE for tick in slow)
    end = result.ticks[-1].state
    assert end.decision.remaining_mm < 0.1
    assert np.linalg.norm(end.p1 - marker_1(result.rig, end.target.q)) < 1.0


@pytest.mark.parametrize(
    "moves", ["camera_pan:at=1.6", "camera_pan:at=1.6,for=4.5,px=45", "freeze:at=1.5"]
)
def test_while_one_marker_is_lost_the_other_shows_camera_faults(
    moves: str,
) -> None:
    result = run_disturbed(f"occlusion:at=1.3,marker=1 {moves}", seconds=5.0)
    stop = result.stop()
    assert stop.state.phase is Phase.PAUSED
    expected = Cause.SURPRISED, Cause.IMPLAUSIBLE, *([Cause.FROZEN] if "freeze" in moves else [])
    assert stop.state.cause in expected
    position = stop.servo.position_of_marker_1
    moved_mm = position(result.ticks[-1].observation.q) - position(stop.observation.q)
    assert np.linalg.norm(moved_mm) < 2.0


@pytest.mark.parametrize("text", [*TABLE, *FOLLOWING])
def test_a_hold_or_pause_brings_the_command_to_zero_in_100_ms_and_a_fault_at_once(
    text: str,
) -> None:
    result = run_disturbed(text, seconds=WATCHED_S)
    stop = result.stop()
    later = stop.time + (0 if stop.state.phase is Phase.FAULT else STOP_TIME * 1e9)
    held = [tick for tick in result.ticks if tick.time >= later and tick.state.phase in STOPPED]
    assert held or stop.state.phase is not Phase.FAULT
    assert all(not tick.state.command.rates.any() for tick in held)
    assert stop.state.phase is not Phase.FAULT or not stop.state.command.enabled


@pytest.mark.parametrize("text", FOLLOWING)
def test_an_axis_that_does_not_follow_is_a_fault_within_2_deg_or_3_mm(
    text: str,
) -> None:
    result = run_disturbed(text, seconds=WATCHED_S)
    stop = result.stop()
    assert (stop.state.phase, stop.state.cause) == (Phase.FAULT, Cause.NOT_FOLLOWING)
    assert np.all(
        np.abs(stop.observation.q - stop.state.monitor.predicted_joints)
        <= [math.radians(2.0), math.radians(2.0), 3.0]
    )


PAUSING = "occlusion:at=1.3"
"""Disturbance that leads to a pause after 1 s."""

CREEP = [
    "creep:at=2.6,axis=1,speed=0.2",
    "creep:at=2.6,axis=2,speed=-1",
    "creep:at=2.6,axis=3,speed=0.1",
    "creep:at=2.6,axis=3,speed=-2",
]


@pytest.mark.parametrize("text", CREEP)
def test_a_drive_that_creeps_without_command_is_a_fault_at_any_speed(
    text: str,
) -> None:
    ticks = run_unattended(f"{PAUSING} {text}", 11.0)
    observation, state = next(tick for tick in ticks if tick[1].phase is Phase.FAULT)
    assert state.cause is Cause.CREEPS
    assert "at rest it should stay within" in state.text
    assert f"joint {text.partition('axis=')[2][0]} " in state.text
    assert np.all(
        np.abs(observation.q - state.monitor.rest_joints)
        <= 1.1 * np.array(Thresholds().max_following_error)
    )


def test_a_drive_may_rest_for_any_time() -> None:
    *_, (_, last) = run_unattended(PAUSING, 15.0)
    assert last.phase is Phase.PAUSED


def run_unattended(text: str, seconds: float) -> Iterator[tuple[Observation, State]]:
    """Return observation and state of every tick of a run without an operator."""
    lab = make_laboratory(disturbances=parse_all(text))
    lab.rig.begin()
    return lab.run(lab.servo(), seconds)


def test_every_kind_occurs_in_these_tests() -> None:
    elsewhere = {"jitter", "kill"}
    frame_by_frame = {kind_of(text) for text in (*TRANSIENT, *PERMANENT)}
    tested = {kind_of(text) for text in (*TABLE, *FOLLOWING, *CREEP)} | elsewhere | frame_by_frame
    assert tested == set(DISTURBANCE_KINDS)


def test_smoke_is_a_hold_for_lost_markers_until_it_has_gone() -> None:
    result = run_disturbed("occlusion:at=1.3,for=0.9,by=smoke", seconds=5.0)
    assert result.stop().state.phase is Phase.HOLD
    assert Cause.MARKERS_LOST in result.causes() <= expected_causes("occlusion")
    assert result.ticks[-1].state.phase is Phase.SERVO


def test_latency_within_100_ms_is_compensated_and_beyond_it_the_servo_holds() -> None:
    assert not run_disturbed("latency:at=1.3,s=0.02").stops()
    late = run_disturbed("latency:at=1.3,s=0.15")
    assert Cause.LATE in late.causes() <= expected_causes("latency")
    assert late.ticks[-1].state.phase is Phase.PAUSED


def test_random_latency_is_a_hold_with_its_cause() -> None:
    result = run_disturbed("latency:at=1.3,for=0.6,s=0,jitter=0.3", seconds=4.5)
    assert {Cause.LATE, Cause.STALE} <= result.causes() <= expected_causes("latency")
    assert result.ticks[-1].state.phase is Phase.SERVO


def test_the_older_of_swapped_frames_is_dropped_and_the_tool_continues() -> None:
    result = run_disturbed("frame_order:at=1.3,for=0.5,what=swapped")
    numbers = [tick.observation.frame for tick in result.ticks]
    assert numbers == sorted(numbers)
    assert any(tick.observation.drop_reason is DropReason.NOT_NEW for tick in result.ticks)
    assert result.causes() == {Cause.AGEING}
    assert not result.stops()


def test_slightly_late_ticks_are_only_a_warning() -> None:
    result = run_disturbed("jitter:at=1.3,s=0.008")
    assert result.causes() == {Cause.LATE_TICK}
    assert not result.stops()


@pytest.mark.parametrize("text", ["jitter:at=1.3,for=0.5,s=0.03", "stall:at=1.3,for=0.03"])
def test_late_ticks_have_their_causes(text: str) -> None:
    assert run_disturbed(text).causes() <= expected_causes(kind_of(text))


def test_one_tick_that_takes_30_ms_longer_is_a_warning() -> None:
    result = run_disturbed("stall:at=1.3,for=0.03,where=tick")
    assert result.causes() == {Cause.LATE_TICK}
    assert not result.stops()


def test_after_the_process_is_killed_the_arm_stops_50_ms_after_its_last_command() -> None:
    result = run_disturbed("kill:at=1.304")
    last, arm = result.ticks[-1], result.rig.truth.arm
    assert last.time == pytest.approx(ONSET * 1e9)
    assert last.state.command.rates.any()
    result.rig.advance_until(last.observation.now + 49_000_000)
    assert arm.watchdog.enabled
    result.rig.advance_until(last.observation.now + 52_000_000)
    assert not arm.watchdog.enabled
    q = arm.q_true
    result.rig.advance_until(last.observation.now + 300_000_000)
    assert np.all(np.abs(arm.q_true - q) < [1e-3, 1e-3, 0.1])


def test_a_silent_arm_stops_and_reports_it_when_it_answers_again() -> None:
    rig = rig_with("arm_silent:at=0.1,for=0.1")
    rig.begin()
    rig.arm.enable()
    reported: list[bool] = []
    true: list[bool] = []
    for k in range(25):
        rig.clock.wait_until(rig.clock.now() + 10_000_000)
        now = rig.clock.now()
        rig.arm.apply(Command(k, now, now + 30_000_000, np.array([0.1, 0.0, 0.0]), True))
        reported.append(rig.arm.measure().enabled)
        true.append(rig.truth.arm.watchdog.enabled)
    assert true == [True] * 12 + [False] * 13
    assert reported == [True] * 19 + [False] * 6


def test_an_emergency_stop_keeps_the_drive_off_until_its_release() -> None:
    rig = rig_with("drive_off:at=0.1,for=0.2")
    rig.begin()
    enabled: list[bool] = []
    for wait in (50_000_000, 100_000_000, 200_000_000):
        rig.clock.wait_until(rig.clock.now() + wait)
        rig.arm.enable()
        rig.clock.wait_until(rig.clock.now() + 2_000_000)
        enabled.append(rig.arm.measure().enabled)
    assert enabled == [True, False, True]


# ---------------------------------------------------------------- disturbances in general


@pytest.mark.parametrize("pictures", [False, True])
def test_a_disturbance_that_never_starts_changes_no_bit(
    pictures: bool,
) -> None:
    plain, late = (
        rig_with("", 3, pictures),
        rig_with("decoy:at=1000", 3, pictures),
    )
    late.begin()
    for rig in (plain, late):
        rig.arm.enable()
    for k in range(10 if pictures else 100):
        frames: list[Frame | None] = []
        for rig in (plain, late):
            rig.clock.wait_until(rig.clock.now() + 10_000_000)
            frames.append(rig.camera.latest())
        assert snapshot(frames[0]) == snapshot(frames[1]), k
        assert snapshot(plain.arm.measure()) == snapshot(late.arm.measure())


def test_no_disturbance_acts_before_the_run_starts() -> None:
    rig = rig_with("occlusion arm_silent encoder_nan disk_full kill")
    rig.move_to_target()
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
    text = " ".join(map(str, sample_disturbances(make_random(seed), 1.0)))
    first, again = (run_disturbed(text, seconds=1.2) for _ in range(2))
    assert [snapshot((tick.observation, tick.state.command)) for tick in first.ticks] == [
        snapshot((tick.observation, tick.state.command)) for tick in again.ticks
    ]


@given(seeds, st.booleans())
def test_a_disturbance_survives_its_text_and_a_pickle(seed: int, pictures: bool) -> None:
    chosen = sample_disturbances(make_random(seed), 20.0, pictures)
    assert 1 <= len(chosen) <= 3
    for disturbance in chosen:
        assert (
            Disturbance.parse(str(disturbance))
            == disturbance
            == pickle.loads(pickle.dumps(disturbance))
        )
        assert disturbance.at <= 20.0
        assert DISTURBANCE_KINDS[disturbance.kind].works_with_images or not pictures


@given(
    st.one_of(
        st.text(max_size=30),
        st.builds(
            "{}:{}".format, st.sampled_from([*DISTURBANCE_KINDS, *OLD_NAMES]), st.text(max_size=20)
        ),
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
def test_old_names_are_read_in_records_and_refused_elsewhere_with_the_new_spelling(
    old: str, new: str
) -> None:
    assert Disturbance.read(old) == Disturbance.parse(new)
    if old != new:
        with pytest.raises(BadInput) as refused:
            Disturbance.parse(old)
        spelling = str(refused.value).partition("written ")[2].partition(" now")[0]
        assert Disturbance.parse(spelling) == Disturbance.parse(new)


def test_each_old_name_is_read_and_none_is_a_kind() -> None:
    assert {Disturbance.read(name).kind for name in OLD_NAMES} <= set(DISTURBANCE_KINDS)
    assert not set(OLD_NAMES) & set(DISTURBANCE_KINDS)


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
def test_an_invalid_disturbance_is_refused_with_its_key(text: str, words: Sequence[str]) -> None:
    with pytest.raises(BadInput) as refused:
        Disturbance.parse(text)
    assert all(word in str(refused.value) for word in words)


def test_only_a_camera_without_images_can_report_points_that_are_not_finite() -> None:
    with pytest.raises(BadInput, match="nan_points"):
        rig_with("nan_points", pictures=True)


def test_every_kind_of_rcmservo_run_is_described_in_a_line() -> None:
    lines = describe_kinds().splitlines()
    assert [line.split(":")[0] for line in lines] == [
        kind for kind in DISTURBANCE_KINDS if kind != "nan_points"
    ]


def test_the_help_of_the_package_lists_every_kind_with_its_defaults() -> None:
    for name, kind in DISTURBANCE_KINDS.items():
        assert f"- {name}:{kind.usage}\n" in (sim.__doc__ or "")


def test_every_kind_has_causes_unless_the_servo_is_dead() -> None:
    assert {name for name in DISTURBANCE_KINDS if not expected_causes(name)} == {"kill"}


# ---------------------------------------------------------------- images


def render_frame(
    text: str, seconds: float, seed: int = 2, tracker: ColourMarkers | None = None
) -> tuple[Rig, Frame]:
    """Return the newest frame so many s after the start; the tracker gets an earlier one first."""
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


def tracking_errors(rig: Rig, frame: Frame, tracker: ColourMarkers) -> np.ndarray:
    """Return the errors (px) of the found markers, NaN where they are lost."""
    true = rig.truth.pixels(rig.truth.joints_at(frame.exposure))
    return np.linalg.norm(tracker.find(frame).points - true, axis=1)


@pytest.mark.parametrize(
    ("marker", "lost"), [(0, [True, True]), (1, [True, False]), (2, [False, True])]
)
def test_a_hidden_marker_is_not_in_the_image_and_the_other_is(
    marker: int, lost: list[bool]
) -> None:
    tracker = ColourMarkers()
    errors = tracking_errors(
        *render_frame(f"occlusion:marker={marker}", 0.1, tracker=tracker), tracker
    )
    assert list(np.isnan(errors)) == lost
    assert np.all(errors[~np.isnan(errors)] < 1.0)


def test_swapped_markers_are_found_at_each_others_position() -> None:
    tracker = ColourMarkers()
    rig, frame = render_frame("swap", 0.1)
    true = rig.truth.pixels(rig.truth.joints_at(frame.exposure))
    assert np.abs(tracker.find(frame).points - true[::-1]).max() < 1.0


@pytest.mark.parametrize("marker", [1, 2])
def test_a_decoy_is_found_at_the_requested_distance(marker: int) -> None:
    tracker = ColourMarkers()
    errors = tracking_errors(*render_frame(f"decoy:px=40,marker={marker}", 0.1), tracker)
    assert errors[marker - 1] == pytest.approx(40.0, abs=1.0)
    assert errors[2 - marker] < 1.0


@pytest.mark.parametrize("text", ["occlusion:for=4,by=smoke", "occlusion:for=4,by=blood"])
@pytest.mark.parametrize("seed", mark_others_slow(range(4)))
def test_no_marker_is_found_behind_dense_smoke_or_blood(text: str, seed: int) -> None:
    tracker = ColourMarkers()
    for seconds in (1.0, 2.5):
        assert np.isnan(tracking_errors(*render_frame(text, seconds, seed, tracker), tracker)).all()


def test_markers_are_found_after_smoke_and_blood() -> None:
    tracker = ColourMarkers()
    assert np.all(
        tracking_errors(
            *render_frame("occlusion:for=0.5,by=smoke occlusion:for=0.5,by=blood", 0.6), tracker
        )
        < 1.0
    )


def test_smoke_rises_and_falls_gradually() -> None:
    smoke = Smoke((640, 480), 4.0, np.array([320.0, 240.0]), make_random(0))
    middle = [
        float(smoke.layer_at(time)[0][60, 80]) for time in (0.0, 0.1, 0.2, 0.3, 2.0, 3.6, 3.8, 4.0)
    ]
    assert middle[0] == middle[-1] == 0.0
    assert middle[4] > 0.95
    assert np.all(np.diff(middle[:5]) > 0.0)
    assert np.all(np.diff(middle[4:]) < 0.0)


def test_an_image_keeps_its_noise_and_size_behind_smoke() -> None:
    _, frame = render_frame("occlusion:for=4,by=smoke", 2.0)
    assert frame.image is not None
    assert frame.image.shape == (240, 320, 3)
    assert frame.image.dtype == np.uint8
    assert np.abs(np.diff(frame.image[120].astype(float), axis=0)).mean() > 1.0


@pytest.mark.parametrize("what", ["size", "half", "noise", "none"])
def test_a_damaged_image_is_empty_or_shows_only_its_rest(what: str) -> None:
    _, frame = render_frame(f"corrupt:what={what}", 0.1)
    if what == "none":
        assert frame.image is None
        return
    assert frame.image is not None
    assert (frame.image.shape == (120, 160, 3)) == (what == "size")
    plain = rig_with("", 2, pictures=True).camera.latest()
    assert plain is not None
    assert not np.array_equal(plain.image, frame.image)
    if what == "half":
        assert np.ptp(frame.image[-20:].astype(int)) <= 2


@pytest.mark.parametrize(
    "text",
    [
        "camera_pan:px=15",
        pytest.param("camera_roll:deg=20", marks=pytest.mark.slow),
        pytest.param("relocate", marks=pytest.mark.slow),
    ],
)
def test_a_moved_camera_images_the_tool_by_its_new_model(text: str) -> None:
    tracker = ColourMarkers()
    old = rig_with(text, 2, pictures=True).scene.optics
    rig, frame = render_frame(text, 0.1)
    assert np.all(tracking_errors(rig, frame, tracker) < 1.0)
    markers = rig.truth.markers(frame.exposure)
    jump = np.linalg.norm(rig.truth.camera_model.project(markers) - old.project(markers), axis=1)
    assert jump.max() > 5.0
    if text.startswith("camera_pan"):
        assert np.all(np.abs(jump - 15.0) < 4.0)


def test_the_operator_counts_accepted_and_refused_requests() -> None:
    rig = rig_with("occlusion:at=1.3,for=3.5")
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = teach(plant, frames=30)
    rig.go_home()
    rig.begin()
    operator = ScriptedOperator(rig, plant, 9, frames=30)
    ticks = list(
        run_attended(
            rig, plant, Servo(rig.settings.mechanism, rig.settings.tool), target, 8.0, operator
        )
    )
    answers = [tick.state.phase for tick in ticks if tick.request is Request.RESUME]
    assert answers == [Phase.PAUSED, Phase.PAUSED, Phase.ACQUIRE]
    assert (operator.resumed, operator.refused) == (1, 2)
