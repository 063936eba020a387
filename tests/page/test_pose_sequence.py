"""A tour: every pose is visited in turn for its dwell, and whatever stops the tool ends it."""

import json
from typing import Any

import numpy as np
import pytest
from test_page_operator import Script, phases, run_loop

import rcmservo as rs
from conftest import Laboratory, laboratory
from rcmservo.loop.operator import same
from rcmservo.page.control_ownership import ControlOwnership, MessageRefused, interpret_message
from rcmservo.page.messages import Go, JogJoints, Note, PoseTaught, SequenceStatus, TeachPose
from rcmservo.page.pose_sequence import RunSequence, SequencePlan, SequenceProgress, Waypoint
from rcmservo.recording.outcome import TOLERANCE

NOW = 10**12
WAYPOINT = {"pose": "a", "dwell": 0.5}


def two_poses() -> tuple[Laboratory, rs.Target, rs.Target]:
    lab = laboratory()
    scene = lab.rig.scene
    lab.rig.place((scene.start + scene.target) / 2.0)
    other = rs.teach(lab.plant, frames=5)
    lab.rig.move_to_start()
    return lab, lab.target, other


def run_sequence(
    dwells: tuple[float, float] = (0.5, 0.3),
    rounds: int = 1,
    seconds: float = 12.0,
    script: Script | None = None,
    last_tick: int = 10**9,
) -> tuple[list[rs.Tick], list[object], rs.Target, rs.Target]:
    lab, a, b = two_poses()
    tour = RunSequence(
        SequencePlan((Waypoint("a", dwells[0]), Waypoint("b", dwells[1])), rounds), (a, b)
    )
    scene: Script = {50: [tour], **(script or {})}
    ticks, browser = run_loop(scene, seconds, last_tick, lab)
    return ticks, browser.messages, a, b


def notes(said: list[object]) -> list[str]:
    return [one.words for one in said if isinstance(one, Note)]


def progress_reports(said: list[object]) -> list[SequenceProgress | None]:
    return [one.progress for one in said if isinstance(one, SequenceStatus)]


def first_tick_towards(ticks: list[rs.Tick], target: rs.Target, after: int) -> int:
    """The first tick on the way to a target."""
    return next(
        k
        for k, tick in enumerate(ticks)
        if k > after
        and tick.state.phase is rs.Phase.SERVO
        and tick.state.target is not None
        and same(tick.state.target, target)
    )


def test_every_pose_is_visited_for_its_whole_dwell_in_every_round_and_then_the_tool_pauses() -> (
    None
):
    ticks, said, a, b = run_sequence(rounds=2, seconds=25.0)
    at = [bool((np.abs(tick.state.delta) < TOLERANCE).all()) for tick in ticks]
    leave = 0
    for target, dwell in ((a, 50), (b, 30), (a, 50), (b, 30)):
        go = first_tick_towards(ticks, target, leave)
        leave = next(
            k
            for k in range(go, len(ticks))
            if ticks[k].state.phase is rs.Phase.PAUSED or not same(ticks[k].state.target, target)
        )
        assert all(at[leave - dwell : leave])
    assert ticks[leave].state.phase is rs.Phase.PAUSED is ticks[-1].state.phase
    assert notes(said) == ["the tour is over: all its poses were visited"]
    told = progress_reports(said)
    assert told[0] == SequenceProgress("a", 1, 2, 1, 2, None) and told[-1] is None
    assert SequenceProgress("b", 2, 2, 2, 2, 1) in told and len(told) < 30


def test_the_tool_reaches_a_pose_without_dwell() -> None:
    ticks, said, a, b = run_sequence(dwells=(0.0, 0.0))
    for target in (a, b):
        there = [t for t in ticks if t.state.target is not None and same(t.state.target, target)]
        seen = [t for t in there if t.state.phase is rs.Phase.SERVO]
        assert len(seen) > 20 and (np.abs(seen[-1].state.delta) < TOLERANCE).all()
    assert notes(said)[-1].startswith("the tour is over")


@pytest.mark.parametrize(
    ("says", "why"),
    [
        ([rs.Request.PAUSE], "paused"),
        ([JogJoints((0.1, 0.0, 0.0), 1)], "paused"),
        (["other"], "elsewhere"),
    ],
)
def test_a_pause_a_jog_button_and_another_go_end_a_sequence_in_a_pause(
    says: list[Any], why: str
) -> None:
    _, _, b = two_poses()
    says = [Go(rs.Target(b.points + 3.0, b.q)) if one == "other" else one for one in says]
    ticks, said, *_ = run_sequence((5.0, 5.0), 9, 9.0, {400: says})
    assert ticks[400].state.phase in (rs.Phase.SERVO, rs.Phase.ACQUIRE)
    assert {tick.state.phase for tick in ticks[404:]} == {rs.Phase.PAUSED}
    assert len(notes(said)) == 1 and why in notes(said)[0] and progress_reports(said)[-1] is None


def test_a_sequence_ends_without_heartbeats_and_resume_does_not_continue_it() -> None:
    ticks, said, *_ = run_sequence((0.0, 0.0), 1000, 9.0, {800: [rs.Request.RESUME]}, last_tick=400)
    assert notes(said)[0].startswith("the tour has ended: paused")
    assert phases(ticks)[-1] is rs.Phase.PAUSED and progress_reports(said)[-1] is None
    later = {id(tick.state.target) for tick in ticks[500:]}
    assert len(later) == 1


def test_teaching_ends_a_sequence() -> None:
    _, said, *_ = run_sequence((5.0, 5.0), 9, 9.0, {500: [TeachPose("here")]})
    assert [one.name for one in said if isinstance(one, PoseTaught)] == ["here"]
    assert "ended" in notes(said)[0] and progress_reports(said)[-1] is None


def interpret(**more: Any) -> Any:
    message = {"do": "tour", "stops": [WAYPOINT], "rounds": 1, "at": NOW - 1} | more
    _, a, _ = POSES
    return interpret_message(json.dumps(message), "a", ControlOwnership("a"), {"a": a}.get, NOW)


POSES = two_poses()


def test_a_sequence_of_known_poses_is_accepted() -> None:
    tour = interpret(stops=[WAYPOINT, WAYPOINT], rounds=1000)
    assert tour.plan == SequencePlan((Waypoint("a", 0.5), Waypoint("a", 0.5)), 1000)
    assert [same(one, POSES[1]) for one in tour.targets] == [True, True]
    interpret(stops=[{"pose": "a", "dwell": 600}] * 20)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"stops": []}, "stops"),
        ({"stops": [WAYPOINT] * 21}, "stops"),
        ({"stops": "a"}, "stops"),
        ({"stops": [{"pose": "b", "dwell": 1}]}, "no pose 'b'"),
        ({"stops": [WAYPOINT, {"pose": "a", "dwell": 601}]}, "dwell"),
        ({"stops": [{"pose": "a", "dwell": -1}]}, "dwell"),
        ({"stops": [{"pose": "a", "dwell": float("nan")}]}, "dwell"),
        ({"stops": [{"pose": "a"}]}, "dwell"),
        ({"stops": [{"pose": 3, "dwell": 1}]}, "pose"),
        ({"rounds": 0}, "rounds"),
        ({"rounds": 1001}, "rounds"),
        ({"rounds": 1.5}, "rounds"),
        ({"rounds": None}, "rounds"),
    ],
)
def test_a_sequence_beyond_the_limits_or_with_an_unknown_pose_is_refused(
    more: dict[str, Any], why: str
) -> None:
    with pytest.raises(MessageRefused, match=why):
        interpret(**more)
