"""Settings on the page: parts of the servo, validated by their dataclasses.

They act at once or from the next session on, and never exceed a given limit.
"""

import json
from dataclasses import fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dashboards import make_dashboard

import rcmservo as rs
from conftest import make_laboratory
from rcmservo.config.field_docs import describe_field
from rcmservo.config.servo_json import describe_servo
from rcmservo.errors import BadInput
from rcmservo.live.unchecked_rig_speed import reduce_speed
from rcmservo.loop.operator import OperatorRequest
from rcmservo.page.channels import PageChannels
from rcmservo.page.control_ownership import ControlOwnership, MessageRefused, interpret_message
from rcmservo.page.messages import Go, Heartbeat, Note, SettingsApplied, SettingsChange, Standby
from rcmservo.page.operator import PageOperator
from rcmservo.page.selected_settings import (
    EDITABLE_PARTS,
    SelectedSettings,
    decode_change,
    describe_estimator,
)
from rcmservo.page.sessions import SessionLoop, SessionRestart
from rcmservo.page.web.page_process import change_settings, dispatch
from rcmservo.page.web.setting_fields import build_forms
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.writer import Recorder

NOW = 10**12


def table_of(part: str, servo: rs.Servo | None = None, **others: Any) -> dict[str, Any]:
    """Return the table that the page sends for a part."""
    content: Any = describe_servo(servo or make_laboratory().servo())
    return content[part] | others


def make_change(part: str, **others: Any) -> SettingsChange:
    return decode_change(part, table_of(part, **others))


def run_session(
    script: dict[int, list[object]],
    seconds: float,
    chosen: SelectedSettings,
    path: Path | None = None,
) -> tuple[list[rs.Tick], list[object]]:
    """Run a session with the page's operator, recorded at the path; return ticks and messages."""
    lab, channels, ticks = make_laboratory(), PageChannels(get_context("spawn")), list[rs.Tick]()
    operator, messages = PageOperator(channels, chosen), list[object]()

    def operate(tick: rs.Tick) -> OperatorRequest:
        for one in script.get(len(ticks) - 1, [Heartbeat()]):
            assert dispatch(one, channels)
        request = operator(tick)
        messages.extend(channels.status.receive_all())
        return request

    servo = chosen.limited
    recorder = Recorder(path, {}) if path else None
    if recorder:
        recorder.begin(servo, lab.target)
    for tick in rs.servo_ticks(lab.plant, servo, lab.target, seconds, operator=operate):
        ticks.append(tick)
        if recorder:
            recorder.write(tick)
    if recorder:
        recorder.close()
    return ticks, messages


def go() -> Go:
    return Go(make_laboratory().target)


def test_a_changed_controller_acts_from_the_next_tick_and_its_record_replays_bit_for_bit(
    tmp_path: Path,
) -> None:
    change = make_change("controller", gain=0.7)
    chosen = SelectedSettings(make_laboratory().servo())
    ticks, messages = run_session(
        {20: [go()], 220: [change]}, 5.0, chosen, tmp_path / reader.RECORD
    )
    assert [ticks[k].servo.controller.gain for k in (220, 221, -1)] == [8.0, 0.7, 0.7]
    speeds = [np.linalg.norm(tick.state.v) for tick in ticks[220:222]]
    assert ticks[220].state.phase is rs.Phase.SERVO and speeds[1] < 0.3 * speeds[0]
    again = replay_record(tmp_path)
    assert again.same, again.sentence
    stages = again.recorded.stages
    assert [stage.mid_run for stage in stages] == [False, True] and stages[1].first == 221
    assert [stage.servo["controller"]["gain"] for stage in stages] == [8.0, 0.7]
    applied = [one.servo.controller.gain for one in messages if isinstance(one, SettingsApplied)]
    assert applied == [8.0, 0.7] and chosen.servo.controller.gain == 8.0


def test_a_change_in_motion_goes_through_the_gate_without_a_jump() -> None:
    servo = make_laboratory().servo()
    slow = SelectedSettings(
        replace(servo, controller=replace(servo.controller, gain=0.5, max_speed=10.0))
    )
    fast = make_change("controller", gain=80.0, max_speed=500.0, bounds=[3.0, 500.0, 500.0])
    ticks, _ = run_session({20: [go()], 260: [fast]}, 4.0, slow)
    rates = np.array([tick.state.command.rates for tick in ticks])
    steps = np.abs(np.diff(rates, axis=0)) * servo.rate
    assert ticks[260].state.phase is rs.Phase.SERVO
    assert (steps <= np.array(servo.gate.slew) * (1.0 + 1e-9)).all()
    assert (np.abs(rates) <= servo.gate.speed).all()
    assert np.abs(rates[261:]).max() > 2.0 * np.abs(rates[200:261]).max()


def test_no_setting_exceeds_the_given_limit() -> None:
    chosen = SelectedSettings(make_laboratory().servo(), reduce_speed)
    fast = make_change("controller", max_speed=1e6)
    ticks, _ = run_session({20: [fast, go()]}, 3.0, chosen)
    full, limited = chosen.servo, ticks[-1].servo
    assert limited.controller.max_speed == pytest.approx(1e5)
    assert limited.gate.speed == reduce_speed(full).gate.speed
    fastest = np.abs([tick.state.command.rates for tick in ticks]).max(axis=0)
    assert (fastest <= 0.1 * (1.0 + 1e-9) * np.array(full.gate.speed)).all() and fastest.any()
    assert not {"gate", "thresholds", "mechanism", "tool"} & set(EDITABLE_PARTS)


def test_the_estimator_stays_during_a_run_and_incompatible_settings_are_reported() -> None:
    chosen = SelectedSettings(make_laboratory().servo())
    flow = decode_change("estimator", {"kind": "flow", "gamma": 0.002})
    sizes = make_change("controller", features="size")
    ticks, messages = run_session(
        {20: [flow], 30: [sizes], 40: [make_change("controller", gain=2.0)]}, 1.0, chosen
    )
    assert {type(tick.servo.estimator) for tick in ticks} == {rs.DltEstimator}
    assert ticks[-1].servo.controller.gain == 2.0 and len(ticks) == 100
    (note,) = [one.words for one in messages if isinstance(one, Note)]
    assert note.startswith("not before the next session: controller.features must be")


def test_waiting_settings_and_targets_are_checked_against_each_other() -> None:
    lab = make_laboratory()
    servo = lab.servo(estimator=rs.AffineEstimator())
    with_sizes = replace(lab.target, sizes=np.array([9.0, 9.0]))
    sizes = make_change("controller", features="size")
    ticks, messages = run_session(
        {20: [Go(with_sizes), sizes, Go(lab.target)]}, 1.0, SelectedSettings(servo)
    )
    assert len(ticks) == 100 and ticks[-1].servo.controller.features == "size"
    assert any("markers' sizes" in one.words for one in messages if isinstance(one, Note))


def interpret(part: object, table: object, control: str = "a", at: int = NOW) -> Any:
    text = json.dumps({"do": "set", "part": part, "table": table, "at": at})
    return interpret_message(text, "a", ControlOwnership(control), lambda name: None, NOW)


def test_a_table_from_a_browser_is_decoded_to_a_change() -> None:
    content = interpret("controller", table_of("controller", gain=3))
    assert content.part == "controller" and content.value == rs.SaturatedController(gain=3.0)


@pytest.mark.parametrize(
    ("part", "table", "reason"),
    [
        ("gate", {}, "part must be one of controller, estimator, exploration, imaged_rcm"),
        (["controller"], {}, "part must be one of"),
        ("controller", None, "controller must be a table"),
        ("controller", {"kind": "saturated"}, "controller.features must be given"),
        ("controller", {"gain": -1.0}, "controller.gain must be a positive gain in 1/s, got -1"),
        ("controller", {"gain": None}, "controller.gain must be a finite number"),
        ("controller", {"gain": float("nan")}, "controller.gain must be a finite number"),
        ("controller", {"bounds": [1.0, 2.0]}, "controller.bounds"),
        ("controller", {"speed": 1.0}, "controller.speed must be left out"),
        ("controller", {"kind": "os:system"}, "controller.kind must be one of saturated"),
        ("exploration", {"min_corners": 2.5}, "exploration.min_corners must be a whole number"),
        ("imaged_rcm", {"lines": 10**6}, "imaged_rcm.lines must be"),
        ("estimator", {"kind": "os:system"}, "user-defined code runs only if"),
    ],
)
def test_an_invalid_table_is_refused_with_the_name_of_the_field(
    part: Any, table: Any, reason: str
) -> None:
    whole = table_of(part) | table if isinstance(table, dict) and part in EDITABLE_PARTS else table
    whole = table if table == {"kind": "saturated"} else whole
    with pytest.raises(MessageRefused) as refused:
        interpret(part, whole)
    assert reason in str(refused.value)


def test_settings_need_control_and_a_recent_display() -> None:
    table = table_of("controller")
    with pytest.raises(MessageRefused, match="another browser has control"):
        interpret("controller", table, control="b")
    with pytest.raises(MessageRefused, match="too old"):
        interpret("controller", table, at=NOW - 10**9)


def test_a_change_goes_to_the_supervisor_always_and_to_the_servo_while_it_runs() -> None:
    channels = PageChannels(get_context("spawn"))
    chosen, board = (
        SelectedSettings(make_laboratory().servo()),
        make_dashboard(channels, standby=Standby("the drive is off")),
    )
    gain, flow = (
        make_change("controller", gain=2.0),
        decode_change("estimator", {"kind": "flow", "gamma": 1.0}),
    )
    assert change_settings(gain, chosen, channels, board) == ""
    board.standby = None
    assert (
        change_settings(gain, chosen, channels, board)
        == change_settings(flow, chosen, channels, board)
        == ""
    )
    sizes = make_change("controller", features="size")
    assert change_settings(sizes, chosen, channels, board).startswith("controller.features must be")
    assert [one.part for one in channels.settings_changes.receive_all()] == [
        "controller",
        "controller",
        "estimator",
    ]
    assert [one.part for one in channels.requests.receive_all()] == ["controller"]
    assert chosen.servo.controller.gain == 2.0 and board.settings_version == 3


def test_settings_restart_only_a_session_that_is_not_enabled() -> None:
    channels, taken = PageChannels(get_context("spawn")), list[SettingsChange]()
    sessions = SessionLoop(channels, lambda: None, lambda began: "", {}, taken.append)  # pyright: ignore
    change = make_change("controller", gain=2.0)
    for waits in (True, False):
        sessions._can_restart = waits
        channels.settings_changes.send(change)
        if waits:
            with pytest.raises(SessionRestart):
                sessions._apply_changes()
        else:
            sessions._apply_changes()
    assert [one.value for one in taken] == [change.value] * 2


def test_every_field_of_a_form_has_its_description_and_unit() -> None:
    servo = make_laboratory().servo()
    by_part = {form["part"]: form for form in build_forms(servo, None)}
    titles = [form["title"] for form in by_part.values()]
    assert titles == ["Controller", "Estimator", "Exploration", "Imaged RCM"]
    assert tuple(by_part) == EDITABLE_PARTS and by_part["estimator"]["selected"] == {"kind": "dlt"}
    for form in by_part.values():
        for kind in form["kinds"].values():
            assert kind["description"] and all(field["description"] for field in kind["fields"])
    law = {field["name"]: field for field in by_part["controller"]["kinds"]["saturated"]["fields"]}
    assert list(law) == [f.name for f in fields(rs.SaturatedController)]
    units = {name: field["unit"] for name, field in law.items() if field["unit"]}
    speeds = {"gain": "1/s", "bounds": "rad, px, px", "max_speed": "mm/s"}
    assert units == speeds | {"tip": "mm", "joint_trust": "1/mm", "approach": "rad, rad, mm"}
    assert law["features"]["choices"] == ["srd", "points", "size"] and law["gain"]["default"] == 8.0
    described = describe_field(rs.SaturatedController, "tip")
    assert described == "Distance from marker 2 to the tip, mm, from 0 to 1000."


def test_the_state_of_the_estimator_is_described() -> None:
    servo = make_laboratory().servo()
    content = [
        describe_estimator(servo, False, np.inf, rs.Phase.PAUSED),
        describe_estimator(servo, False, np.inf, rs.Phase.ACQUIRE),
        describe_estimator(servo, True, 12.3456, rs.Phase.SERVO),
        describe_estimator(servo, True, 100.0, rs.Phase.SERVO),
    ]
    assert content == [
        "Estimator dlt: no estimate yet; Go explores first",
        "Estimator dlt: exploring",
        "Estimator dlt: explored, condition of Ĵ 12.3",
        "Estimator dlt: explored, condition of Ĵ 100, so high that the controller is damped",
    ]


def test_incompatible_settings_change_nothing() -> None:
    chosen = SelectedSettings(make_laboratory().servo())
    before = chosen.servo
    with pytest.raises(BadInput):
        chosen.apply(make_change("controller", features="size"))
    assert chosen.servo is before
