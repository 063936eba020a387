"""Settings on the page: whole boxes, validated by their dataclass, that hold at once or from the
next session on, and never loosen a bound that was handed in.
"""

import json
from dataclasses import fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import board_at

import rcmservo as rs
from conftest import laboratory
from rcmservo.config.field_docs import describe_field
from rcmservo.config.servo_json import describe
from rcmservo.errors import BadInput
from rcmservo.live.reduced_speed import reduce_speed
from rcmservo.loop.operator import OperatorRequest
from rcmservo.page.channels import Desk
from rcmservo.page.control_ownership import Control, Unheeded, heard
from rcmservo.page.messages import Beat, Between, Change, Go, InForce, Note
from rcmservo.page.operator import PageOperator
from rcmservo.page.sessions import Again, Sessions
from rcmservo.page.settings import BOXES, Chosen, change_of, standing
from rcmservo.page.web.page_process import done, set_box
from rcmservo.page.web.setting_fields import forms
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.writer import Recorder

NOW = 10**12


def table_of(box: str, servo: rs.Servo | None = None, **others: Any) -> dict[str, Any]:
    """What the page sends for a box."""
    told: Any = describe(servo or laboratory().servo())
    return told[box] | others


def changed(box: str, **others: Any) -> Change:
    return change_of(box, table_of(box, **others))


def ran(
    says: dict[int, list[object]], seconds: float, chosen: Chosen, path: Path | None = None
) -> tuple[list[rs.Tick], list[object]]:
    """A session under the page's operator, recorded at the path."""
    lab, desk, ticks = laboratory(), Desk(get_context("spawn")), list[rs.Tick]()
    operator, said = PageOperator(desk, chosen), list[object]()

    def person(tick: rs.Tick) -> OperatorRequest:
        for one in says.get(len(ticks) - 1, [Beat()]):
            assert done(one, desk)
        want = operator(tick)
        said.extend(desk.said.heard())
        return want

    servo = chosen.limited
    recorder = Recorder(path, {}) if path else None
    if recorder:
        recorder.begin(servo, lab.target)
    for tick in rs.run(lab.plant, servo, lab.target, seconds, operator=person):
        ticks.append(tick)
        if recorder:
            recorder.write(tick)
    if recorder:
        recorder.close()
    return ticks, said


def go() -> Go:
    return Go(laboratory().target)


def test_a_changed_controller_holds_from_the_next_tick_on_and_its_record_replays_bit_for_bit(
    tmp_path: Path,
) -> None:
    change = changed("controller", gain=0.7)
    chosen = Chosen(laboratory().servo())
    ticks, said = ran({20: [go()], 220: [change]}, 5.0, chosen, tmp_path / reader.RECORD)
    assert [ticks[k].servo.controller.gain for k in (220, 221, -1)] == [8.0, 0.7, 0.7]
    speeds = [np.linalg.norm(tick.state.v) for tick in ticks[220:222]]
    assert ticks[220].state.phase is rs.Phase.SERVO and speeds[1] < 0.3 * speeds[0]
    again = replay_record(tmp_path)
    assert again.same, again.sentence
    stages = again.recorded.stages
    assert [stage.mid_run for stage in stages] == [False, True] and stages[1].first == 221
    assert [stage.servo["controller"]["gain"] for stage in stages] == [8.0, 0.7]
    forced = [one.servo.controller.gain for one in said if isinstance(one, InForce)]
    assert forced == [8.0, 0.7] and chosen.servo.controller.gain == 8.0


def test_a_change_in_motion_goes_through_the_gate_without_a_jump() -> None:
    servo = laboratory().servo()
    slow = Chosen(replace(servo, controller=replace(servo.controller, gain=0.5, max_speed=2.0)))
    fast = changed("controller", gain=80.0, max_speed=500.0, bounds=[3.0, 500.0, 500.0])
    ticks, _ = ran({20: [go()], 260: [fast]}, 4.0, slow)
    rates = np.array([tick.state.command.rates for tick in ticks])
    steps = np.abs(np.diff(rates, axis=0)) * servo.rate
    assert ticks[260].state.phase is rs.Phase.SERVO
    assert (steps <= np.array(servo.gate.slew) * (1.0 + 1e-9)).all()
    assert (np.abs(rates) <= servo.gate.speed).all()
    assert np.abs(rates[261:]).max() > 2.0 * np.abs(rates[200:261]).max()


def test_no_setting_undoes_the_limit_that_was_handed_in() -> None:
    chosen = Chosen(laboratory().servo(), reduce_speed)
    fast = changed("controller", max_speed=1e6)
    ticks, _ = ran({20: [fast, go()]}, 3.0, chosen)
    full, held = chosen.servo, ticks[-1].servo
    assert held.controller.max_speed == pytest.approx(1e5)
    assert held.gate.speed == reduce_speed(full).gate.speed
    fastest = np.abs([tick.state.command.rates for tick in ticks]).max(axis=0)
    assert (fastest <= 0.1 * (1.0 + 1e-9) * np.array(full.gate.speed)).all() and fastest.any()
    assert not {"gate", "thresholds", "mechanism", "tool"} & set(BOXES)


def test_in_mid_run_what_was_learnt_by_stays_and_what_does_not_go_together_is_told() -> None:
    chosen = Chosen(laboratory().servo())
    flow = change_of("estimator", {"kind": "flow", "gamma": 0.002})
    sizes = changed("controller", features="size")
    ticks, said = ran({20: [flow], 30: [sizes], 40: [changed("controller", gain=2.0)]}, 1.0, chosen)
    assert {type(tick.servo.estimator) for tick in ticks} == {rs.DltEstimator}
    assert ticks[-1].servo.controller.gain == 2.0 and len(ticks) == 100
    (note,) = [one.words for one in said if isinstance(one, Note)]
    assert note.startswith("not before the next session: controller.features must be")


def test_settings_and_a_target_that_wait_together_are_checked_against_each_other() -> None:
    lab = laboratory()
    servo = lab.servo(estimator=rs.AffineEstimator())
    with_sizes = replace(lab.target, sizes=np.array([9.0, 9.0]))
    sizes = changed("controller", features="size")
    ticks, said = ran({20: [Go(with_sizes), sizes, Go(lab.target)]}, 1.0, Chosen(servo))
    assert len(ticks) == 100 and ticks[-1].servo.controller.features == "size"
    assert any("markers' sizes" in one.words for one in said if isinstance(one, Note))


def said_of(box: object, table: object, control: str = "a", at: int = NOW) -> Any:
    text = json.dumps({"do": "set", "box": box, "table": table, "at": at})
    return heard(text, "a", Control(control), lambda name: None, NOW)


def test_a_table_from_a_browser_is_a_change_of_a_box() -> None:
    told = said_of("controller", table_of("controller", gain=3))
    assert told.box == "controller" and told.value == rs.SaturatedController(gain=3.0)


@pytest.mark.parametrize(
    ("box", "table", "why"),
    [
        ("gate", {}, "box must be one of controller, estimator, exploration, imaged_rcm"),
        (["controller"], {}, "box must be one of"),
        ("controller", None, "controller must be a table"),
        ("controller", {"kind": "saturated"}, "controller.features must be given"),
        ("controller", {"gain": -1.0}, "controller.gain must be a positive gain in 1/s, got -1"),
        ("controller", {"gain": None}, "controller.gain must be a finite number"),
        ("controller", {"gain": float("nan")}, "controller.gain must be a finite number"),
        ("controller", {"bounds": [1.0, 2.0]}, "controller.bounds"),
        ("controller", {"speed": 1.0}, "controller.speed must be left out"),
        ("controller", {"kind": "os:system"}, "controller.kind must be one of saturated"),
        ("exploration", {"legs": 2.5}, "exploration.legs must be a whole number"),
        ("imaged_rcm", {"lines": 10**6}, "imaged_rcm.lines must be"),
        ("estimator", {"kind": "os:system"}, "user-defined code runs only if"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_by_its_field(box: Any, table: Any, why: str) -> None:
    whole = table_of(box) | table if isinstance(table, dict) and box in BOXES else table
    whole = table if table == {"kind": "saturated"} else whole
    with pytest.raises(Unheeded) as refused:
        said_of(box, whole)
    assert why in str(refused.value)


def test_settings_need_control_and_freshness() -> None:
    table = table_of("controller")
    with pytest.raises(Unheeded, match="another browser has control"):
        said_of("controller", table, control="b")
    with pytest.raises(Unheeded, match="too late"):
        said_of("controller", table, at=NOW - 10**9)


def test_a_change_goes_to_the_supervisor_always_and_to_the_servo_while_it_runs() -> None:
    desk = Desk(get_context("spawn"))
    chosen, board = (
        Chosen(laboratory().servo()),
        board_at(desk, between=Between("the drive is off")),
    )
    gain, flow = (
        changed("controller", gain=2.0),
        change_of("estimator", {"kind": "flow", "gamma": 1.0}),
    )
    assert set_box(gain, chosen, desk, board) == ""
    board.between = None
    assert set_box(gain, chosen, desk, board) == set_box(flow, chosen, desk, board) == ""
    sizes = changed("controller", features="size")
    assert set_box(sizes, chosen, desk, board).startswith("controller.features must be")
    assert [one.box for one in desk.changes.heard()] == ["controller", "controller", "estimator"]
    assert [one.box for one in desk.wants.heard()] == ["controller"]
    assert chosen.servo.controller.gain == 2.0 and board.changes == 3


def test_settings_begin_a_session_anew_that_is_not_enabled_and_leave_one_that_is_alone() -> None:
    desk, taken = Desk(get_context("spawn")), list[Change]()
    sessions = Sessions(desk, lambda: None, lambda began: "", {}, taken.append)  # pyright: ignore
    change = changed("controller", gain=2.0)
    for waits in (True, False):
        sessions._waits = waits
        desk.changes.put(change)
        if waits:
            with pytest.raises(Again):
                sessions._changed()
        else:
            sessions._changed()
    assert [one.value for one in taken] == [change.value] * 2


def test_every_field_of_a_form_has_its_words_and_its_unit() -> None:
    servo = laboratory().servo()
    by_box = {form["box"]: form for form in forms(servo, None)}
    titles = [form["title"] for form in by_box.values()]
    assert titles == ["Controller", "Estimator", "Exploration", "Imaged RCM"]
    assert tuple(by_box) == BOXES and by_box["estimator"]["set"] == {"kind": "dlt"}
    for form in by_box.values():
        for kind in form["kinds"].values():
            assert kind["words"] and all(field["words"] for field in kind["fields"])
    law = {field["name"]: field for field in by_box["controller"]["kinds"]["saturated"]["fields"]}
    assert list(law) == [f.name for f in fields(rs.SaturatedController)]
    units = {name: field["unit"] for name, field in law.items() if field["unit"]}
    assert units == {"gain": "1/s", "bounds": "rad, px, px", "max_speed": "mm/s", "tip": "mm"}
    assert law["features"]["choices"] == ["srd", "points", "size"] and law["gain"]["default"] == 8.0
    described = describe_field(rs.SaturatedController, "tip")
    assert described == "How far the tip is beyond marker 2, mm."


def test_the_estimators_standing_is_told_in_words() -> None:
    servo = laboratory().servo()
    told = [
        standing(servo, False, np.inf, rs.Phase.PAUSED),
        standing(servo, False, np.inf, rs.Phase.ACQUIRE),
        standing(servo, True, 12.3456, rs.Phase.SERVO),
        standing(servo, True, 100.0, rs.Phase.SERVO),
    ]
    assert told == [
        "Estimator dlt: knows nothing yet, Go explores first",
        "Estimator dlt: exploring",
        "Estimator dlt: explored, condition of Ĵ 12.3",
        "Estimator dlt: explored, condition of Ĵ 100, so high that the law is damped",
    ]


def test_what_does_not_go_together_changes_nothing() -> None:
    chosen = Chosen(laboratory().servo())
    before = chosen.servo
    with pytest.raises(BadInput):
        chosen.take(changed("controller", features="size"))
    assert chosen.servo is before
