"""Pose sequences: each pose is visited for its dwell, and whatever stops the tool ends them."""

import json
from typing import Any

import numpy as np
import pytest
from test_page_operator import Script, phases, run_loop

import rcmservo as rs
from conftest import Laboratory, make_laboratory
from rcmservo.page.control_ownership import ControlOwnership, MessageRefused, interpret_message
from rcmservo.page.messages import Go, JogJoints, Note, PoseTaught, SequenceStatus, TeachPose
from rcmservo.page.pose_sequence import RunSequence, SequencePlan, SequenceProgress, Waypoint
from rcmservo.recording.outcome import SETTLED_TOLERANCE

NOW = 10**12
WAYPOINT = {"pose": "a", "dwell": 0.5}


def two_poses() -> tuple[Laboratory, rs.Target, rs.Target]:
    lab = make_laboratory()
    scene = lab.rig.scene
    lab.rig.place((scene.start + scene.target) / 2.0)
    other = rs.teach(lab.plant, frames=5)
    lab.rig.go_home()
    return lab, lab.target, other


def run_sequence(
    dwells: tuple[float, float] = (0.5, 0.3),
    rounds: int = 1,
    seconds: float = 12.0,
    script: Script | None = None,
    last_tick: int = 10**9,
) -> tuple[list[rs.Tick], list[object], rs.Target, rs.Target]:
    lab, a, b = two_poses()
    request = RunSequence(
        SequencePlan((Waypoint("a", dwells[0]), Waypoint("b", dwells[1])), rounds), (a, b)
    )
    scene: Script = {50: [request], **(script or {})}
    ticks, browser = run_loop(scene, seconds, last_tick, lab)
    return ticks, browser.messages, a, b


def notes(messages: list[object]) -> list[str]:
    return [one.words for one in messages if isinstance(one, Note)]


def progress_reports(messages: list[object]) -> list[SequenceProgress | None]:
    return [one.progress for one in messages if isinstance(one, SequenceStatus)]


def first_tick_towards(ticks: list[rs.Tick], target: rs.Target, after: int) -> int:
    """Return the first tick of the motion to a target."""
    return next(
        k
        for k, tick in enumerate(ticks)
        if k > after and tick.state.phase is rs.Phase.SERVO and tick.state.target == target
    )


def test_every_pose_is_visited_for_its_whole_dwell_in_every_round_and_then_the_tool_pauses() -> (
    None
):
    ticks, messages, a, b = run_sequence(rounds=2, seconds=25.0)
    at = [bool((np.abs(tick.state.delta) < SETTLED_TOLERANCE).all()) for tick in ticks]
    leave = 0
    for target, dwell in ((a, 50), (b, 30), (a, 50), (b, 30)):
        go = first_tick_towards(ticks, target, leave)
        leave = next(
            k
            for k in range(go, len(ticks))
            if ticks[k].state.phase is rs.Phase.PAUSED or ticks[k].state.target != target
        )
        assert all(at[leave - dwell : leave])
    assert ticks[leave].state.phase is rs.Phase.PAUSED is ticks[-1].state.phase
    assert notes(messages) == ["the pose sequence is complete"]
    reports = progress_reports(messages)
    assert reports[0] == SequenceProgress("a", 1, 2, 1, 2, None) and reports[-1] is None
    assert SequenceProgress("b", 2, 2, 2, 2, 1) in reports and len(reports) < 30


def test_the_tool_reaches_a_pose_without_dwell() -> None:
    ticks, messages, a, b = run_sequence(dwells=(0.0, 0.0))
    for target in (a, b):
        towards = [t for t in ticks if t.state.target == target]
        in_servo = [t for t in towards if t.state.phase is rs.Phase.SERVO]
        assert len(in_servo) > 20 and (np.abs(in_servo[-1].state.delta) < SETTLED_TOLERANCE).all()
    assert notes(messages)[-1].startswith("the pose sequence is complete")


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ([rs.Request.PAUSE], "paused"),
        ([JogJoints((0.1, 0.0, 0.0), 1)], "paused"),
        (["other"], "another target"),
    ],
)
def test_a_pause_a_jog_button_and_another_go_end_a_sequence_in_a_pause(
    script: list[Any], reason: str
) -> None:
    _, _, b = two_poses()
    script = [Go(rs.Target(b.points + 3.0, b.q)) if one == "other" else one for one in script]
    ticks, messages, *_ = run_sequence((5.0, 5.0), 9, 6.0, {400: script})
    assert ticks[400].state.phase in (rs.Phase.SERVO, rs.Phase.ACQUIRE)
    assert {tick.state.phase for tick in ticks[404:]} == {rs.Phase.PAUSED}
    assert (
        len(notes(messages)) == 1
        and reason in notes(messages)[0]
        and progress_reports(messages)[-1] is None
    )


def test_a_sequence_ends_without_heartbeats_and_resume_does_not_continue_it() -> None:
    ticks, messages, *_ = run_sequence(
        (0.0, 0.0), 1000, 9.0, {800: [rs.Request.RESUME]}, last_tick=400
    )
    assert notes(messages)[0].startswith("the pose sequence has ended: paused")
    assert phases(ticks)[-1] is rs.Phase.PAUSED and progress_reports(messages)[-1] is None
    later = {id(tick.state.target) for tick in ticks[500:]}
    assert len(later) == 1


def test_teaching_ends_a_sequence() -> None:
    _, messages, *_ = run_sequence((5.0, 5.0), 9, 7.0, {500: [TeachPose("here")]})
    assert [one.name for one in messages if isinstance(one, PoseTaught)] == ["here"]
    assert "ended" in notes(messages)[0] and progress_reports(messages)[-1] is None


def interpret(**changes: Any) -> Any:
    message = {"do": "sequence", "waypoints": [WAYPOINT], "rounds": 1, "at": NOW - 1} | changes
    _, a, _ = POSES
    return interpret_message(json.dumps(message), "a", ControlOwnership("a"), {"a": a}.get, NOW)


POSES = two_poses()


def test_a_sequence_of_known_poses_is_accepted() -> None:
    request = interpret(waypoints=[WAYPOINT, WAYPOINT], rounds=1000)
    assert request.plan == SequencePlan((Waypoint("a", 0.5), Waypoint("a", 0.5)), 1000)
    assert [one == POSES[1] for one in request.targets] == [True, True]
    interpret(waypoints=[{"pose": "a", "dwell": 600}] * 20)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"waypoints": []}, "waypoints"),
        ({"waypoints": [WAYPOINT] * 21}, "waypoints"),
        ({"waypoints": "a"}, "waypoints"),
        ({"waypoints": [{"pose": "b", "dwell": 1}]}, "no pose 'b'"),
        ({"waypoints": [WAYPOINT, {"pose": "a", "dwell": 601}]}, "dwell"),
        ({"waypoints": [{"pose": "a", "dwell": -1}]}, "dwell"),
        ({"waypoints": [{"pose": "a", "dwell": float("nan")}]}, "dwell"),
        ({"waypoints": [{"pose": "a"}]}, "dwell"),
        ({"waypoints": [{"pose": 3, "dwell": 1}]}, "pose"),
        ({"rounds": 0}, "rounds"),
        ({"rounds": 1001}, "rounds"),
        ({"rounds": 1.5}, "rounds"),
        ({"rounds": None}, "rounds"),
    ],
)
def test_a_sequence_beyond_the_limits_or_with_an_unknown_pose_is_refused(
    changes: dict[str, Any], reason: str
) -> None:
    with pytest.raises(MessageRefused, match=reason):
        interpret(**changes)
