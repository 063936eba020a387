"""`show`: summary, timeline and figures agree with the run."""

import json
from dataclasses import asdict, astuple, dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import replays
from replays import Disturbed

import rcmservo as rs
from rcmservo.cli import show
from rcmservo.cli.cli import main
from rcmservo.figures import plots
from rcmservo.interfaces import DropReason
from rcmservo.recording import reader, timeline
from rcmservo.recording.outcome import OutcomeCollector
from rcmservo.recording.timeline import list_spans, summarise_record
from rcmservo.recording.writer import Recorder
from rcmservo.rig.result import METRICS_FILE
from rcmservo.tracking import PointMarkers


@dataclass
class RecordedRun:
    """Recorded run of two stages with lost markers, dropped frames and requests of the operator."""

    path: Path
    ticks: list[rs.Tick]
    stages: list[int]
    judge: OutcomeCollector
    servo: rs.Servo
    target: rs.Target


def disturb_observation(observation: rs.Observation) -> rs.Observation:
    """Hide marker 2 from 3.0 to 3.3 s and both from 3.4 to 3.6 s; damage frames from 5 s on.

    The damage lasts until 5.03 s. Times are those of the plant's clock.
    """
    points = observation.points.copy()
    second = observation.now * 1e-9
    points[1] = np.nan if 3.0 < second < 3.3 else points[1]
    points[:] = np.nan if 3.4 < second < 3.6 else points
    return rs.Observation(
        **{
            **observation.__dict__,
            "points": points,
            "drop_reason": DropReason.DAMAGED if 5.0 < second < 5.03 else DropReason.NONE,
        }
    )


@pytest.fixture(scope="module")
def recorded_run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    rig = rs.sim.Rig(1, rs.sim.RigSettings(point_noise=0.1), pictures=False)
    plant = Disturbed(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    rig.move_to_target()
    target = rs.teach(plant, frames=5)
    rig.go_home()
    plant.change = disturb_observation
    path = tmp_path_factory.mktemp("run") / reader.RECORD
    ticks, stages, state = [], [], None
    with Recorder(path, {"seed": 1, "simulation": True}) as recorder:
        for seconds in (1.5, 8.5):
            stages.append(len(ticks))
            judge = OutcomeCollector(servo, target)
            recorder.begin(servo, target, state)
            for tick in rs.servo_ticks(
                plant, servo, target, seconds, state=state, operator=replays.operator
            ):
                recorder.write(tick)
                ticks.append(tick)
                judge.add(tick)
            state = ticks[-1].state
    return RecordedRun(path, ticks, stages, judge, servo, target)


def test_spans_cover_all_ticks_in_order_and_successive_spans_differ(
    recorded_run: RecordedRun,
) -> None:
    rows = reader.read_record(recorded_run.path)
    found = list_spans(rows)
    assert found[0].start == 0.0 and found[-1].end == pytest.approx(rows.time[-1] + 0.01)
    for one, next in pairwise(found):
        assert one.end == next.start and one.duration > 0.0
        alike = (one.phase, one.cause, one.stage) == (next.phase, next.cause, next.stage)
        assert not alike or next.request is not rs.Request.NONE
    starts = [span.start for span in found]
    for i, tick in enumerate(recorded_run.ticks):
        span = found[int(np.searchsorted(starts, rows.time[i], side="right")) - 1]
        assert (span.phase, span.cause) == (tick.state.phase, tick.state.cause)
        assert span.action is tick.state.mode.action
        assert span.stage == int(i >= recorded_run.stages[1])


@pytest.mark.parametrize("share,late", [(0.5, 0), (0.2, 1)])
def test_a_tick_is_late_by_the_threshold_of_the_recorded_servo(
    recorded_run: RecordedRun, tmp_path: Path, share: float, late: int
) -> None:
    servo = replace(recorded_run.servo, thresholds=rs.Thresholds(late_tick_fraction=share))
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(servo, recorded_run.target)
        for i, tick in enumerate(recorded_run.ticks[:20]):
            now = tick.observation.now + 3_000_000 * (i >= 10)
            recorder.write(
                replace(tick, servo=servo, observation=replace(tick.observation, now=now))
            )
    loop = summarise_record(reader.read_record(tmp_path)).loop
    assert loop is not None and loop.late == late


@pytest.mark.usefixtures("blank_figures")
def test_every_request_of_the_operator_is_shown_including_refused_ones(
    recorded_run: RecordedRun, tmp_path: Path
) -> None:
    """Send three requests to resume that change neither phase nor cause."""
    paused = next(tick for tick in recorded_run.ticks if tick.state.phase is rs.Phase.PAUSED)
    asking = {10: rs.Request.RESUME, 20: rs.Request.RESUME, 30: rs.Request.RESUME}
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(recorded_run.servo, recorded_run.target)
        for i in range(40):
            recorder.write(replace(paused, time=i * 10**7, request=asking.get(i, rs.Request.NONE)))
    rows = reader.read_record(tmp_path)
    requests = [(round(span.start, 2), span.request) for span in list_spans(rows)]
    assert requests[1:] == [(i * 0.01, request) for i, request in asking.items()]
    show._write_timeline_and_figures(rows, list_spans(rows), tmp_path)
    assert (tmp_path / "timeline.csv").read_text().count("RESUME") == 3
    (requests,) = [
        lane
        for panel in plots.plot_timeline(rows).panels
        for lane in panel.lanes
        if "operator requests" in lane.label
    ]
    assert len(requests.bars) == 3


def test_the_summary_agrees_with_the_ticks(recorded_run: RecordedRun) -> None:
    got = summarise_record(reader.read_record(recorded_run.path))
    loop, used = got.loop, got.frames
    assert loop is not None and used is not None
    frames = {
        tick.observation.frame: tick
        for tick in reversed(recorded_run.ticks)
        if tick.observation.frame >= 0
    }
    latency = [
        (tick.observation.now - tick.observation.exposure) * 1e-9 for tick in frames.values()
    ]
    assert loop.ticks == len(recorded_run.ticks) == 1000
    assert used.used == len(frames)
    spread = [1e3 * one for one in (*np.percentile(latency, [50, 99]), max(latency))]
    assert astuple(loop.latency_ms) == pytest.approx(spread)
    assert (loop.late, loop.longest_ms) == (0, pytest.approx(10.0))
    assert used.dropped == {
        DropReason.DAMAGED.text: sum(
            tick.observation.drop_reason is DropReason.DAMAGED for tick in recorded_run.ticks
        )
    }


def test_the_verdict_equals_that_of_the_run(recorded_run: RecordedRun) -> None:
    got, live = (
        summarise_record(reader.read_record(recorded_run.path)),
        recorded_run.judge.compute_result(),
    )
    assert (got.settled, got.cause) == (live.settled, live.cause)
    assert astuple(got.feature_error) == pytest.approx(astuple(live.feature_error))
    assert got.settled
    assert live.settle_time_s is not None and got.settle_time_s is not None
    assert got.settle_time_s == pytest.approx(live.settle_time_s + 1.5, abs=0.5)


def test_a_record_of_an_earlier_version_agrees_with_its_metrics() -> None:
    folder = Path(__file__).parents[1] / "data/v0.1.0"
    now = asdict(summarise_record(reader.read_record(folder)))
    then = json.loads((folder / METRICS_FILE).read_text())
    for name in ("settled", "cause", "settle_time_s", "jacobian_error"):
        assert now[name] == then[name]
    for name in ("feature_error", "explore"):
        assert now[name] == pytest.approx(then[name])
    assert now["loop"]["latency_ms"]["median"] == pytest.approx(1e3 * then["latency_s"]["median"])


def test_show_prints_causes_and_remedies_and_draws_figures(
    recorded_run: RecordedRun,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["show", str(recorded_run.path.parent), "--out", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    for words in (
        "settled",
        "simulation with seed 1",
        "estimator dlt",
        "2, begun at 0.00 s",
        "marker 2 is not detected: marker 1 and the joints determine the pose",
        "neither marker is detected: both left the image or are hidden",
        "clear the camera's view, then resume",
        "the operator requested a pause",
        "after the operator's request to resume",
        "frames arrive damaged at",
        "late ticks",
    ):
        assert words in text
    for name in ("timeline", "errors", "estimate"):
        assert cv2.imread(str(tmp_path / "out" / f"{name}.png")) is not None
    assert text.endswith(f"\nfigures and timeline.csv in {tmp_path / 'out'}\n")
    lines = (tmp_path / "out" / "timeline.csv").read_text().splitlines()
    assert len(lines) == 1 + len(list_spans(reader.read_record(recorded_run.path)))


@pytest.mark.usefixtures("blank_figures")
def test_a_truncated_record_is_shown_with_its_missing_parts(
    recorded_run: RecordedRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = recorded_run.path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    assert main(["show", str(tmp_path / "cut.mcap"), "--out", str(tmp_path / "out")]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "damaged or cut off" in text
    assert "as far as the record can be read" in text


def recorded_until(recorded_run: RecordedRun, path: Path, seconds: float, **about: object) -> Path:
    """Write a record of the second stage only, up to a time."""
    with Recorder(path, about) as recorder:
        recorder.begin(recorded_run.servo, recorded_run.target)
        for tick in recorded_run.ticks[recorded_run.stages[1] :]:
            if tick.time < seconds * 1e9:
                recorder.write(tick)
    return path


@pytest.mark.parametrize(("until", "planned"), [(7.0, 8.0), (0.5, 60.0), (8.5, 8.7)])
def test_a_record_that_ends_early_gives_no_verdict(
    until: float, planned: float, recorded_run: RecordedRun, tmp_path: Path
) -> None:
    rows = reader.read_record(
        recorded_until(recorded_run, tmp_path / "r.mcap", until, duration_s=planned)
    )
    got = summarise_record(rows)
    assert rows.complete
    assert (got.settled, got.settle_time_s) == (False, None)
    assert (
        got.cause
        == f"the record ends at {until:.2f} s of {planned:.2f} s: what came after is not in it"
    )


@pytest.mark.parametrize(
    "about", [{"duration_s": 8.5}, {"duration_s": 8.55}, {"duration_s": 3.0}, {}]
)
def test_a_complete_record_gives_the_verdict(
    about: dict[str, float], recorded_run: RecordedRun, tmp_path: Path
) -> None:
    assert summarise_record(
        reader.read_record(recorded_until(recorded_run, tmp_path / "r.mcap", 8.5, **about))
    ).settled


def test_a_run_that_ended_early_reports_its_cause(
    recorded_run: RecordedRun, tmp_path: Path
) -> None:
    paused = next(
        tick
        for tick in recorded_run.ticks[recorded_run.stages[1] :]
        if tick.state.phase is rs.Phase.PAUSED
    )
    path = recorded_until(
        recorded_run, tmp_path / "r.mcap", paused.time * 1e-9 + 0.001, duration_s=60.0
    )
    assert summarise_record(reader.read_record(path)).cause == rs.Cause.ASKED.text


@pytest.mark.parametrize(("about", "words"), [({"duration_s": 8.5}, " s of 8.50 s"), ({}, " s: ")])
def test_a_truncated_record_never_reports_settled_or_a_time_out(
    about: dict[str, float], words: str, recorded_run: RecordedRun, tmp_path: Path
) -> None:
    data = recorded_until(recorded_run, tmp_path / "whole.mcap", 8.5, **about).read_bytes()
    causes = []
    for share in (0.03, 0.3, 0.5, 0.7, 0.9):
        (tmp_path / "cut.mcap").write_bytes(data[: int(len(data) * share)])
        got = summarise_record(reader.read_record(tmp_path / "cut.mcap"))
        assert not got.settled and "time ran out" not in got.cause
        causes.append(got.cause)
    assert all(cause.startswith("the record ends at ") and words in cause for cause in causes)


def test_an_empty_record_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(servo, rs.Target(np.ones((2, 2)), np.ones(3)))
    assert main(["show", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    output = capsys.readouterr().out
    assert "stopped before its first tick" in output
    assert output.endswith(
        f"\ntimeline.csv in {tmp_path / 'out'}; the record holds no data for figures\n"
    )
    assert "ms between two" not in output


def test_a_file_that_is_no_record_gives_one_sentence_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("show", "export"):
        assert main([command, str(tmp_path / "no.mcap"), "--out", str(tmp_path / "out")]) == 2
        assert "no.mcap" in capsys.readouterr().err
    (tmp_path / "poor.mcap").write_bytes(b"not a record")
    assert main(["show", str(tmp_path / "poor.mcap"), "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


def test_replay_of_a_run_reports_equal_decisions(
    recorded_run: RecordedRun, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recorded_run.path.parent)]) == 0
    assert "all 1000 ticks came out the same, bit for bit" in capsys.readouterr().out


def test_replay_with_other_settings_is_an_open_loop_and_reads_the_record_once(
    recorded_run: RecordedRun,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read: list[Path] = []
    monkeypatch.setattr(
        reader,
        "read_record",
        lambda path, original=reader.read_record: read.append(path) or original(path),
    )
    assert main(["replay", str(recorded_run.path), "--controller.gain", "4"]) == 1
    assert "open loop, with other settings" in capsys.readouterr().out
    assert len(read) == 1


def test_a_long_timeline_is_cut_in_the_middle(
    recorded_run: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(show, "FIRST_SPAN_COUNT", 3)
    monkeypatch.setattr(show, "LAST_SPAN_COUNT", 2)
    found = list_spans(reader.read_record(recorded_run.path))
    table = show._build_timeline_table(found)
    assert table.row_count == 3 + 1 + 2
    assert f"… {len(found) - 5} more, in timeline.csv" in list(table.columns[2].cells)


def test_exploration_is_shaded_only_while_the_servo_explores(recorded_run: RecordedRun) -> None:
    rows = reader.read_record(recorded_run.path)
    shaded = plots.find_exploration_spans(rows)
    inside = np.array([any(start <= time < end for start, end in shaded) for time in rows.time])
    exploring = [
        tick.state.phase is rs.Phase.ACQUIRE and not tick.state.explored
        for tick in recorded_run.ticks
    ]
    np.testing.assert_array_equal(inside, exploring)
    assert shaded


def test_every_phase_and_cause_has_its_line_in_the_figure(recorded_run: RecordedRun) -> None:
    rows = reader.read_record(recorded_run.path)
    figure = plots.plot_timeline(rows)
    labels = [lane.label.replace("\n", " ") for panel in figure.panels for lane in panel.lanes]
    for span in list_spans(rows):
        assert span.phase.value in labels
        assert span.cause is rs.Cause.NONE or span.cause.value in labels
    assert len(figure.panels[0].bands) == len(list_spans(rows))
    assert timeline.read_rate(rows) == 100.0


def test_the_path_leads_from_exploration_to_the_target(recorded_run: RecordedRun) -> None:
    front, top, picture = plots.plot_path(reader.read_record(recorded_run.path)).panels
    p1 = recorded_run.servo.position_of_marker_1(recorded_run.target.q)
    for panel, axes in ((front, [0, 1]), (top, [0, 2])):
        exploring, motion, target_curve = panel.curves
        assert [*target_curve.x, *target_curve.y] == pytest.approx(p1[axes], abs=1e-3)
        assert [motion.x[-1], motion.y[-1]] == pytest.approx(p1[axes], abs=1.0)
        known = [sum(value is not None for value in one.y) for one in (exploring, motion)]
        assert 0 < known[0] < known[1] and panel.map
    for i, marker in enumerate(picture.curves[:2]):
        assert [marker.x[-1], marker.y[-1]] == pytest.approx(recorded_run.target.points[i], abs=2.0)
    assert picture.map and picture.downward
