"""Operator at the page: nothing moves without a request, nothing continues without heartbeats."""

from functools import cache
from multiprocessing import get_context

import numpy as np
import pytest

import rcmservo as rs
from conftest import Laboratory, make_laboratory
from rcmservo.loop.operator import OperatorRequest
from rcmservo.page.channels import DUE_TIME, TICK_SLOTS, PageChannels
from rcmservo.page.control_ownership import ControlOwnership
from rcmservo.page.jog_state import JogState
from rcmservo.page.messages import (
    Go,
    Heartbeat,
    JogJoints,
    JogMarker,
    Note,
    PoseTaught,
    ReleaseJog,
    TargetChanged,
    TeachingStatus,
    TeachPose,
)
from rcmservo.page.operator import HEARTBEAT_TIMEOUT_NS, JOG_TIMEOUT_NS, PageOperator
from rcmservo.page.selected_settings import SelectedSettings
from rcmservo.page.web.page_process import dispatch, pause_on_handover
from rcmservo.recording.ros2_messages import encode_tick
from rcmservo.safety.state_machine import SLOW_SPEED_SCALE

Script = dict[int, list[object]]
"""Messages of the page by the tick after which they are sent."""


@cache
def get_initial_laboratory() -> Laboratory:
    """Return a laboratory in which nothing moves, for its servo and its target."""
    return make_laboratory()


class Browser:
    """Simulated browser: sends messages after given ticks, and heartbeats until a given tick."""

    def __init__(self, channels: PageChannels, script: Script, last_tick: int = 10**9) -> None:
        self.channels, self.script, self.last_tick, self.tick = channels, script, last_tick, -1
        self.operator = PageOperator(
            channels, SelectedSettings(get_initial_laboratory().servo()), frames=30
        )
        self.messages: list[object] = []

    def __call__(self, tick: rs.Tick) -> OperatorRequest:
        self.tick += 1
        if self.tick < self.last_tick and self.tick % 10 == 0 and self.tick not in self.script:
            assert dispatch(Heartbeat(), self.channels)
        for one in self.script.get(self.tick, []):
            assert dispatch(one, self.channels)
        request = self.operator(tick)
        self.messages += self.channels.status.receive_all()
        return request


def run_loop(
    script: Script, seconds: float, last_tick: int = 10**9, lab: Laboratory | None = None
) -> tuple[list[rs.Tick], Browser]:
    lab = lab or make_laboratory()
    browser = Browser(PageChannels(get_context("spawn")), script, last_tick)
    ticks = rs.servo_ticks(lab.plant, lab.servo(), lab.target, seconds, operator=browser)
    return list(ticks), browser


def phases(ticks: list[rs.Tick]) -> list[rs.Phase]:
    found = [tick.state.phase for tick in ticks]
    return [one for i, one in enumerate(found) if i == 0 or found[i - 1] is not one]


def hold_button(ticks: range, rates: tuple[float, float, float], press: int = 1) -> Script:
    """Return the messages of a held button, repeated at 25 Hz or more as by a browser."""
    return {k: [JogJoints(rates, press)] for k in ticks if k % 4 == ticks.start % 4 or k % 10 == 0}


def jog_ticks(ticks: list[rs.Tick]) -> list[int]:
    return [k for k, tick in enumerate(ticks) if tick.state.phase is rs.Phase.JOG]


def test_a_session_begins_paused_and_nothing_moves_without_a_request() -> None:
    ticks, _ = run_loop({}, 2.0)
    assert phases(ticks) == [rs.Phase.IDLE, rs.Phase.PAUSED]
    assert not any(tick.state.command.rates.any() for tick in ticks)


def test_go_sets_the_target_and_resumes_and_a_second_go_changes_the_target() -> None:
    lab = make_laboratory()
    scene = lab.rig.scene
    lab.rig.place((scene.start + scene.target) / 2.0)
    other = rs.teach(lab.plant, frames=5)
    lab.rig.go_home()
    ticks, browser = run_loop({50: [Go(lab.target)], 300: [Go(other)]}, 6.0, lab=lab)
    assert phases(ticks).count(rs.Phase.PAUSED) == 1 and rs.Phase.SERVO in phases(ticks)
    assert np.abs(ticks[-1].state.delta / (0.02, 1.5, 1.5)).max() < 1.0
    first, second = [one.target for one in browser.messages if isinstance(one, TargetChanged)]
    assert first == lab.target and second == other


@pytest.mark.parametrize("last_tick", [150, 300])
def test_autonomous_motion_is_paused_without_heartbeats(last_tick: int) -> None:
    target = get_initial_laboratory().target
    ticks, _ = run_loop({50: [Go(target)]}, 5.0, last_tick)
    last_beat = (last_tick - 1) // 10 * 10
    first = next(
        k for k, tick in enumerate(ticks) if k > 60 and tick.state.phase is rs.Phase.PAUSED
    )
    assert 0 <= first - last_beat - HEARTBEAT_TIMEOUT_NS // 10_000_000 <= 3
    assert not any(tick.state.command.rates.any() for tick in ticks[first + 15 :])
    assert phases(ticks)[-1] is rs.Phase.PAUSED


def test_a_held_button_moves_the_joints_until_the_browser_is_silent() -> None:
    rates = (0.1, 0.0, 0.0)
    ticks, _ = run_loop(hold_button(range(100, 200), rates), 4.0, last_tick=100)
    moving = [k for k, tick in enumerate(ticks) if tick.state.command.rates.any()]
    assert moving[0] == 101
    assert moving[-1] <= 196 + JOG_TIMEOUT_NS // 10_000_000 + 3 + 1
    assert ticks[-1].observation.q[0] - ticks[0].observation.q[0] == pytest.approx(0.1, rel=0.12)
    assert phases(ticks)[-2:] == [rs.Phase.JOG, rs.Phase.PAUSED]


@pytest.mark.parametrize(("axis", "speed"), [(0, 10.0), (1, -10.0), (2, 10.0)])
def test_marker_1_is_jogged_along_a_straight_line_in_the_arms_base_frame(
    axis: int, speed: float
) -> None:
    velocity = [0.0, 0.0, 0.0]
    velocity[axis] = speed
    press = JogMarker((velocity[0], velocity[1], velocity[2]), 1)
    ticks, browser = run_loop({k: [press] for k in range(100, 160, 4)}, 2.2)
    begun, ended = jog_ticks(ticks)[0], jog_ticks(ticks)[-1]
    servo = browser.operator._selection.servo
    moved = servo.position_of_marker_1(ticks[ended].observation.q) - servo.position_of_marker_1(
        ticks[begun].observation.q
    )
    along = moved[axis] * np.sign(speed)
    assert 3.0 < along < 7.0 and np.linalg.norm(np.delete(moved, axis)) < 0.05 * along
    assert phases(ticks)[-1] is rs.Phase.PAUSED


def test_a_jog_has_its_fraction_of_the_jog_speed_whatever_the_request() -> None:
    for speed_scale in (0.25, 1.0):
        for press in (
            JogJoints((1e9, 0.0, 1.0), 1, speed_scale),
            JogMarker((0.0, -1e9, 1e9), 1, speed_scale),
        ):
            ticks, browser = run_loop({k: [press] for k in range(100, 140, 4)}, 2.0)
            limits = np.array(browser.operator._selection.servo.gate.speed) * SLOW_SPEED_SCALE
            used = max(np.abs(tick.state.command.rates / limits).max() for tick in ticks)
            assert used == pytest.approx(speed_scale)


def test_a_released_button_stops_the_jog_at_the_next_tick() -> None:
    script = hold_button(range(100, 150), (0.1, 0.0, 0.0)) | {150: [ReleaseJog()]}
    ticks, _ = run_loop(script, 3.0)
    assert jog_ticks(ticks) == list(range(101, 151))


def test_a_press_that_a_pause_ended_stays_ended_and_the_next_one_counts() -> None:
    rates = (0.1, 0.0, 0.0)
    script = hold_button(range(100, 300), rates, 1)
    script[150] = [rs.Request.PAUSE]
    script |= hold_button(range(320, 400), rates, 2)
    ticks_in_jog = jog_ticks(run_loop(script, 5.0)[0])
    assert (
        ticks_in_jog[0] == 101
        and not set(range(151, 320)) & set(ticks_in_jog)
        and 321 in ticks_in_jog
    )


def test_a_late_repetition_stops_the_tool_and_the_next_one_moves_it_again() -> None:
    rates = (0.1, 0.0, 0.0)
    script = hold_button(range(100, 121), rates) | hold_button(range(140, 180), rates)
    ticks_in_jog = jog_ticks(run_loop(script, 3.0, last_tick=100)[0])
    last = 120 + JOG_TIMEOUT_NS // 10_000_000
    assert ticks_in_jog[0] == 101 and not set(range(last + 2, 140)) & set(ticks_in_jog)
    assert set(range(141, 180)) <= set(ticks_in_jog)


def test_a_press_ends_after_a_second_of_silence_and_the_next_one_counts() -> None:
    rates = (0.1, 0.0, 0.0)
    script = hold_button(range(100, 121), rates, 1) | hold_button(range(240, 280), rates, 1)
    script |= hold_button(range(300, 320), rates, 2)
    ticks, browser = run_loop(script, 4.0, last_tick=100)
    assert set(range(130, 301)).isdisjoint(jog_ticks(ticks)) and 301 in jog_ticks(ticks)
    notes = [one.words for one in browser.messages if isinstance(one, Note)]
    assert notes == ["the browser was silent during a jog: press the button again"]


def test_a_press_ends_with_a_pause_while_its_repetition_is_late() -> None:
    rates = (0.1, 0.0, 0.0)
    script = hold_button(range(100, 121), rates) | hold_button(range(140, 180), rates)
    script[135] = [rs.Request.PAUSE]
    assert set(range(130, 300)).isdisjoint(jog_ticks(run_loop(script, 3.0, last_tick=100)[0]))


def test_a_button_held_before_the_session_began_moves_nothing_in_it() -> None:
    lab, channels = make_laboratory(), PageChannels(get_context("spawn"))
    channels.jog_state.hold(7, (0.1, 0.0, 0.0))
    browser = Browser(channels, hold_button(range(0, 200), (0.1, 0.0, 0.0), 7))
    ticks = list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, 3.0, operator=browser))
    assert not jog_ticks(ticks) and len(ticks) == 300


def test_a_half_written_jog_command_is_ignored() -> None:
    jog_state = JogState(get_context("spawn"))
    jog_state.hold(3, (1.0, 2.0, 3.0))
    assert jog_state.read() == (1, 3, 1.0, 2.0, 3.0, 1.0, False)
    jog_state.ring.slot(jog_state.ring.newest)[40] ^= 1
    assert jog_state.read() is None


def test_a_transfer_of_control_pauses_the_motion() -> None:
    control, target = ControlOwnership(), get_initial_laboratory().target
    first = control.join(0)
    second = control.join(0)
    control.request(second, 1)

    class BrowserThatHandsOver(Browser):
        def __call__(self, tick: rs.Tick) -> OperatorRequest:
            if self.tick + 1 == 200:
                with pause_on_handover(control, self.channels):
                    control.hand_over(first, 2)
            return super().__call__(tick)

    lab = make_laboratory()
    browser = BrowserThatHandsOver(PageChannels(get_context("spawn")), {50: [Go(target)]})
    ticks = list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, 4.0, operator=browser))
    assert control.holder == second
    assert ticks[200].state.phase in (rs.Phase.ACQUIRE, rs.Phase.SERVO)
    assert {tick.state.phase for tick in ticks[201:]} == {rs.Phase.PAUSED}


def test_cancelled_teaching_is_reported_and_its_progress_ends() -> None:
    _, browser = run_loop({100: [TeachPose("above")], 110: [rs.Request.PAUSE]}, 3.0)
    assert [one.words for one in browser.messages if isinstance(one, TeachingStatus)][-1] == ""
    notes = [one.words for one in browser.messages if isinstance(one, Note)]
    assert notes == ["above was not taught"]
    assert not any(isinstance(one, PoseTaught) for one in browser.messages)


def test_a_requested_target_is_not_stored_as_the_taught_pose() -> None:
    target = get_initial_laboratory().target
    _, browser = run_loop({100: [Go(target), TeachPose("above")]}, 3.0)
    (taught,) = [one for one in browser.messages if isinstance(one, PoseTaught)]
    assert taught.target != target


@pytest.fixture(scope="module")
def taught_pose() -> tuple[list[rs.Tick], Browser]:
    """Return a run in which a pose is taught."""
    return run_loop({100: [TeachPose("above")]}, 3.0)


def test_a_pose_is_taught_under_its_name(taught_pose: tuple[list[rs.Tick], Browser]) -> None:
    ticks, browser = taught_pose
    (taught,) = [one for one in browser.messages if isinstance(one, PoseTaught)]
    assert taught.name == "above"
    assert np.allclose(taught.target.points, ticks[-1].observation.points, atol=1.5)
    assert taught.target.points.tobytes() == ticks[-1].state.target.points.tobytes()


def test_teaching_takes_the_requested_frames_and_reports_its_progress(
    taught_pose: tuple[list[rs.Tick], Browser],
) -> None:
    """The page reports progress because teaching takes seconds."""
    _, browser = taught_pose
    reports = [one.words for one in browser.messages if isinstance(one, TeachingStatus)]
    precision = "the precision of the image is known once the tool has explored"
    assert reports[0] == f"teaching, keep the tool still: 1 of 30 frames; {precision}"
    assert len(reports) >= 3 and reports[-1] == ""
    (end,) = [i for i, one in enumerate(browser.messages) if isinstance(one, PoseTaught)]
    assert all(one.words == "" for one in browser.messages[end:] if isinstance(one, TeachingStatus))


def test_teaching_again_is_reported_and_stores_no_pose() -> None:
    ticks, browser = run_loop({100: [TeachPose("")]}, 3.0)
    notes = [one.words for one in browser.messages if isinstance(one, Note)]
    assert notes == ["the target was taught again"]
    assert not any(isinstance(one, PoseTaught) for one in browser.messages)
    _, target = [one.target for one in browser.messages if isinstance(one, TargetChanged)]
    assert target == ticks[-1].state.target


def test_a_target_that_the_settings_refuse_is_reported_and_the_loop_continues() -> None:
    lab = make_laboratory()
    target = rs.Target(lab.target.points + 1.0, lab.target.q)
    servo = lab.servo(
        estimator=rs.AffineEstimator(), controller=rs.SaturatedController(features="size")
    )
    channels = PageChannels(get_context("spawn"))
    browser = Browser(channels, {20: [Go(target)]})
    target_with_sizes = rs.Target(
        lab.target.points, lab.target.q, lab.target.taught_at, np.array([9.0, 9.0])
    )
    ticks = list(rs.servo_ticks(lab.plant, servo, target_with_sizes, 1.0, operator=browser))
    assert len(ticks) == 100 and phases(ticks)[-1] is rs.Phase.PAUSED
    assert any("markers' sizes" in one.words for one in browser.messages if isinstance(one, Note))


def test_the_ring_holds_the_newest_ticks_as_in_a_record() -> None:
    ticks, browser = run_loop({}, 6.0)
    newest, found = browser.channels.ticks.read_after(-1)
    assert newest == len(ticks) - 1 == 599 and len(found) == TICK_SLOTS
    assert found == [encode_tick(tick) + DUE_TIME.pack(tick.time) for tick in ticks[-TICK_SLOTS:]]
    assert browser.channels.ticks.read_after(newest) == (newest, [])
    assert browser.channels.ticks.read_after(newest - 3) == (newest, found[-3:])
    browser.channels.ticks.slot(newest)[100] ^= 1
    assert browser.channels.ticks.read_after(newest - 3) == (newest, found[-3:-1])
