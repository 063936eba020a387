"""A record gives back what was written, bit for bit, and opens in other people's tools."""

import errno
import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import rcmservo as rs
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.record import reader
from rcmservo.record import ros2_messages as ros2
from rcmservo.record.columns import LATER
from rcmservo.record.recompute import recompute
from rcmservo.record.writer import FRAMES_WAITING, WAITING, Recorder, ThreadedRecorder
from rcmservo.tracking import PointMarkers


@dataclass
class Written:
    """A run of three seconds and the folder of its record."""

    folder: Path
    ticks: list[rs.Tick]
    servo: rs.Servo
    target: rs.Target

    @property
    def path(self) -> Path:
        return self.folder / reader.RECORD


def run_of(folder: Path, **choices: Any) -> Written:
    rig = rs.sim.Rig(1, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0), **choices)
    rig.show_target()
    target = rs.teach(plant, frames=30)
    rig.go_home()
    run = Written(folder, [], servo, target)
    with Recorder(run.path, {"seed": 1}) as recorder:
        recorder.begin(servo, target)
        for tick in rs.run(plant, servo, target, duration=3.0):
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
            run.ticks.append(tick)
    return run


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return run_of(tmp_path_factory.mktemp("record"))


@pytest.fixture(scope="module")
def by_rule_21(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return run_of(tmp_path_factory.mktemp("record"), estimator=ProjectionEstimator())


def told(tick: rs.Tick) -> dict[str, Any]:
    """What a record must tell of a tick, by the record's names."""
    seen, state = tick.seen, tick.state
    return {
        "now": seen.now,
        "q": seen.q,
        "q_time": seen.q_time,
        "enabled": seen.enabled,
        "applied_before": seen.applied,
        "frame": seen.frame,
        "exposure": seen.exposure,
        "arrival": seen.arrival,
        "q_exposure": seen.q_exposure,
        "points": seen.points,
        "sizes": seen.sizes,
        "recorded": seen.recorded,
        "believed": state.believed,
        "since": state.mode.since,
        "good": state.mode.good,
        "explored": state.explored,
        "o_c": state.o_c,
        "p1": state.p1,
        "y": state.y,
        "rcm_condition": state.learnt.estimate.rcm_condition,
        "delta": state.delta,
        "ahead": state.learnt.estimate.ahead,
        "J_hat": state.J_hat,
        "condition": state.condition,
        "v": state.v,
        "a_hat": getattr(state.learnt.memory, "a_hat", np.full(9, np.nan)),
        "latency": state.watch.latency,
        "period": state.watch.period,
        "command": state.command.rates,
        "command_number": state.command.number,
        "command_time": state.command.time,
        "command_deadline": state.command.deadline,
        "command_enabled": state.command.enabled,
        "applied": tick.applied,
        "jog": tick.jog,
        "quality": tick.seen.quality,
    }


def words(tick: rs.Tick) -> dict[str, str]:
    mode = tick.state.mode
    names = {"phase": mode.phase, "cause": mode.cause, "asks": mode.asks}
    names |= {"request": tick.request, "dropped": tick.seen.dropped}
    return {name: value.name for name, value in names.items()}


@pytest.mark.parametrize("which", ["written", "by_rule_21"])
def test_every_number_and_word_of_a_tick_comes_back_bit_for_bit(
    which: str, request: pytest.FixtureRequest
) -> None:
    """And what the estimator remembers: â, or the numbers that it says."""
    written: Written = request.getfixturevalue(which)
    rows = reader.read(written.folder)
    assert rows.complete and rows.missing == ""
    assert rows.about == {"seed": 1}
    assert len(rows.time) == len(written.ticks) == 300
    assert {"IDLE", "ACQUIRE", "SERVO"} <= set(rows.phase)
    for i, tick in enumerate(written.ticks):
        expected = told(tick)
        remembered = written.servo.estimator.remembered(tick.state.learnt.memory)
        if remembered is not None:
            expected["memory"] = remembered
        assert set(expected) | {"model"} == set(rows.ticks)
        for name, value in expected.items():
            column = rows.ticks[name]
            assert (
                column[i].tobytes()
                == np.ravel(value).astype(column.dtype, casting="safe").tobytes()
            ), name
        assert {name: column[i] for name, column in rows.words.items()} == words(tick)
    assert (rows.truth["p2"] == 2.0).all() and len(rows.truth["p2"]) == 300


def test_the_model_of_a_record_is_what_the_estimate_predicts(written: Written) -> None:
    state, rows = written.ticks[200].state, reader.read(written.path)
    predicted = written.servo.estimator.predict(state.learnt.memory, written.servo.tool, state.p1)
    np.testing.assert_array_equal(rows.ticks["model"][200], predicted)


def test_integers_beyond_those_that_a_float_can_count_come_back(
    written: Written, tmp_path: Path
) -> None:
    tick, now = written.ticks[100], 2**62 + 1
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(written.servo, written.target)
        recorder.write(replace(tick, seen=replace(tick.seen, now=now, exposure=now - 3)))
    rows = reader.read(tmp_path)
    assert (rows.ticks["now"][0, 0], rows.ticks["exposure"][0, 0]) == (now, now - 3)


def test_a_stage_tells_the_whole_servo_and_its_target(written: Written) -> None:
    (stage,) = reader.read(written.folder).stages
    assert (stage.first, stage.origin) == (0, -1)
    np.testing.assert_array_equal(stage.target.points, written.target.points)
    np.testing.assert_array_equal(stage.target.q, written.target.q)
    assert stage.servo["estimator"]["kind"] == "dlt"
    assert stage.servo["rate"] == 100.0


def test_a_second_stage_tells_where_it_goes_on_from(written: Written, tmp_path: Path) -> None:
    ticks, servo, shown_again = written.ticks, written.servo, replace(written.target)
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(servo, written.target)
        recorder.write(ticks[0])
        recorder.write(ticks[1])
        recorder.begin(servo, written.target, ticks[1].state)
        recorder.write(ticks[0])
        recorder.begin(servo, shown_again, ticks[1].state)
        recorder.begin(servo, shown_again, ticks[2].state)
    stages = reader.read(tmp_path).stages
    assert [stage.first for stage in stages] == [0, 2, 3, 3]
    assert [stage.origin for stage in stages] == [-1, 0, 0, -2]


def test_times_go_on_where_a_stage_counts_them_anew(written: Written, tmp_path: Path) -> None:
    later = [
        replace(tick, seen=replace(tick.seen, now=tick.seen.now + 10**10))
        for tick in written.ticks[:3]
    ]
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        for stage in (written.ticks[:3], later):
            recorder.begin(written.servo, written.target)
            for tick in stage:
                recorder.write(tick)
    np.testing.assert_allclose(
        reader.read(tmp_path).time, [0.0, 0.01, 0.02, 10.0, 10.01, 10.02], atol=2e-3
    )


def test_the_decoder_of_another_project_reads_the_same_ticks_and_joints(written: Written) -> None:
    rows = reader.read(written.folder)
    count = 0
    with written.path.open("rb") as file:
        mcap = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in mcap.iter_decoded_messages():
            if channel.topic == "rcmservo/tick":
                for name in rows.ticks.keys() - {"memory"}:
                    np.testing.assert_array_equal(
                        np.ravel(getattr(decoded, name.lower())),
                        rows.ticks[name][count],
                        err_msg=name,
                    )
                for name, names in rows.words.items():
                    assert getattr(decoded, name) == names[count]
                assert message.log_time == written.ticks[count].time
                stamp = decoded.header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == written.ticks[count].seen.now
                count += 1
    assert count == 300


def test_a_run_is_a_ros_2_bag_with_joints_in_si_units(written: Written) -> None:
    joints: dict[str, list[Any]] = {
        "measured_js": [],
        "servo_jv": [],
        "rcmservo/tick": [],
        "rcmservo/about": [],
    }
    with AnyReader([written.folder]) as bag:
        assert {c.topic: c.msgtype for c in bag.connections}[
            "measured_js"
        ] == "sensor_msgs/msg/JointState"
        for connection, _, raw in bag.messages():
            if connection.topic in joints:
                joints[connection.topic].append(bag.deserialize(raw, connection.msgtype))
    tick = written.ticks[250]
    measured, commanded = joints["measured_js"][250], joints["servo_jv"][250]
    assert measured.name == commanded.name == ["theta", "phi", "rho"]
    assert measured.position == pytest.approx(tick.seen.q * [1.0, 1.0, 1e-3])
    assert commanded.velocity == pytest.approx(tick.state.command.rates * [1.0, 1.0, 1e-3])
    assert len(measured.velocity) == len(commanded.position) == len(measured.effort) == 0
    assert joints["rcmservo/tick"][250].phase == tick.state.phase.name
    np.testing.assert_array_equal(joints["rcmservo/tick"][250].j_hat, tick.state.J_hat.ravel())
    assert json.loads(joints["rcmservo/about"][0].data) == {"seed": 1}


def test_joints_that_are_not_known_are_left_out_of_joint_states() -> None:
    names = "theta", "phi", "rho"
    known, unknown = (ros2.encode_positions(names, 5, q) for q in (np.ones(3), np.full(3, np.nan)))
    decode = DecoderFactory().decoder_for("cdr", _schema("sensor_msgs/msg/JointState"))
    assert decode is not None
    assert len(decode(known).position) == 3
    assert len(decode(unknown).position) == 0


def _schema(name: str) -> Any:
    from mcap.records import Schema

    return Schema(id=1, name=name, encoding="ros2msg", data=ros2.DEFINITIONS[name].encode())


def test_frames_come_back_with_their_exposure(written: Written, tmp_path: Path) -> None:
    rig = rs.sim.Rig(1, replace(rs.sim.Rig(1, pictures=False).settings, width=160, height=120))
    rig.clock.wait_until(200_000_000)
    frame = rig.camera.latest()
    assert frame is not None and frame.image is not None
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(written.servo, written.target)
        recorder.write_frame(frame)
        recorder.write_frame(rs.Frame(7, -5, 0, image=frame.image))
    assert reader.read(tmp_path).complete
    (first, picture), (second, _) = reader.frames(tmp_path)
    assert (first, second) == (frame.exposure, -5)
    assert picture.shape == frame.image.shape
    assert np.abs(picture.astype(int) - frame.image).mean() < 3.0
    with AnyReader([tmp_path]) as bag:
        images = [
            bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages() if "image" in c.topic
        ]
    assert images[0].format == "jpeg" and images[0].data[:3].tobytes() == b"\xff\xd8\xff"


class Full:
    """A disk with room for so many bytes."""

    def __init__(self, path: Path, room: int) -> None:
        self._file, self._room = path.open("xb", buffering=0), room

    def write(self, data: memoryview) -> int | None:
        if not self._room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = self._file.write(data[: self._room])
        self._room -= count or 0
        return count

    def close(self) -> None:
        self._file.close()


@pytest.mark.parametrize("room", [0, 5, 20_000, 60_000])
def test_a_full_disk_raises_nothing_and_leaves_what_was_written(
    room: int, written: Written, tmp_path: Path
) -> None:
    path = tmp_path / "record.mcap"
    with Recorder(path, {"seed": 1}, open_file=lambda path: Full(path, room)) as recorder:
        recorder.begin(written.servo, written.target)
        for tick in written.ticks:
            recorder.write(tick)
        assert not recorder.recorded()
    assert "No space left" in recorder.failed and "record.mcap" in recorder.failed
    assert path.stat().st_size == room
    if room < 10_000:
        with pytest.raises(rs.UnusableFile):
            reader.read(path)
        return
    rows = reader.read(path)
    assert not rows.complete
    assert len(rows.time) > 5
    np.testing.assert_array_equal(
        rows.ticks["q"], [tick.seen.q for tick in written.ticks[: len(rows.time)]]
    )


class Slow(Full):
    """A disk that takes a hundred bytes at a time, and nothing at all when it is full."""

    def write(self, data: memoryview) -> int | None:
        return super().write(data[:100]) if self._room else 0


def test_a_disk_that_takes_little_at_a_time_gets_the_same_record(
    written: Written, tmp_path: Path
) -> None:
    path = tmp_path / "record.mcap"
    with Recorder(path, {"seed": 1}, open_file=lambda path: Slow(path, 10**9)) as recorder:
        recorder.begin(written.servo, written.target)
        for tick in written.ticks:
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
    assert recorder.recorded()
    assert path.read_bytes() == written.path.read_bytes()


def test_a_disk_that_takes_nothing_more_is_full(written: Written, tmp_path: Path) -> None:
    with Recorder(
        tmp_path / "record.mcap", {}, open_file=lambda path: Slow(path, 5000)
    ) as recorder:
        recorder.begin(written.servo, written.target)
        for tick in written.ticks[:50]:
            recorder.write(tick)
    assert "nothing more can be written" in recorder.failed


def test_a_limit_on_the_size_of_files_is_a_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "record.mcap"
    code = f"""
import resource
from pathlib import Path
import numpy as np
import rcmservo as rs
from rcmservo.record.writer import Recorder
with Recorder(Path({str(path)!r}), {{"seed": 1}}) as recorder:
    room = recorder.path.stat().st_size + 100
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0))
    recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))
    print(recorder.failed)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "cannot be written" in out.stdout
    assert reader.read(tmp_path).about == {"seed": 1}


def test_a_run_pauses_when_its_record_can_no_longer_be_written(tmp_path: Path) -> None:
    rig = rs.sim.Rig(1, pictures=False)
    recorder = Recorder(tmp_path / "record.mcap", {}, open_file=lambda path: Full(path, 30_000))
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock, recorder.recorded)
    target = rs.teach(plant, frames=3)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    with recorder:
        recorder.begin(servo, target)
        for tick in rs.run(plant, servo, target, duration=3.0):
            recorder.write(tick)
    assert (tick.state.phase, tick.state.cause) == (rs.Phase.PAUSED, rs.Cause.NOT_RECORDED)


def test_a_killed_process_leaves_all_but_the_last_ticks(written: Written, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "record.mcap", {})
    recorder.begin(written.servo, written.target)
    for count, tick in enumerate(written.ticks):
        recorder.write(tick)
        if count % 37 == 0:
            size = recorder.path.stat().st_size
            left = tmp_path / "left.mcap"
            left.write_bytes(recorder.path.read_bytes())
            assert left.stat().st_size == size
            rows = reader.read(left)
            assert not rows.complete and "not ended" in rows.missing
            assert len(rows.time) >= count + 1 - 20
    recorder.close()


def test_a_record_that_is_there_already_is_not_touched(written: Written) -> None:
    before = written.path.read_bytes()
    with pytest.raises(rs.UnusableFile, match="exists"):
        Recorder(written.path, {})
    assert written.path.read_bytes() == before


def test_a_thread_writes_the_same_record(written: Written, tmp_path: Path) -> None:
    with ThreadedRecorder(Recorder(tmp_path / "record.mcap", {"seed": 1})) as recorder:
        recorder.begin(written.servo, written.target)
        for tick in written.ticks:
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
    assert recorder.recorded()
    assert (tmp_path / "record.mcap").read_bytes() == written.path.read_bytes()


class Stuck:
    """A disk that takes nothing until it is let go."""

    def __init__(self, path: Path, go: threading.Event) -> None:
        self._file, self._go = path.open("xb", buffering=0), go

    def write(self, data: memoryview) -> int | None:
        self._go.wait(30.0)
        return self._file.write(data)

    def close(self) -> None:
        self._file.close()


def test_a_stuck_disk_never_holds_the_loop_up(written: Written, tmp_path: Path) -> None:
    go = threading.Event()
    go.set()
    path = tmp_path / "record.mcap"
    with ThreadedRecorder(Recorder(path, {}, open_file=lambda path: Stuck(path, go))) as recorder:
        recorder.begin(written.servo, written.target)
        go.clear()
        taken = 0
        while recorder.recorded():
            recorder.write(written.ticks[taken % 300])
            taken += 1
        recorder.write(written.ticks[0])
        go.set()
    assert WAITING <= taken <= WAITING + 20
    assert "too slow" in recorder.failed
    rows = reader.read(path)
    assert not rows.complete
    assert taken - WAITING - 10 <= len(rows.time) <= taken


def test_frames_that_wait_are_bounded(written: Written, tmp_path: Path) -> None:
    go = threading.Event()
    go.set()
    with ThreadedRecorder(
        Recorder(tmp_path / "r.mcap", {}, open_file=lambda path: Stuck(path, go))
    ) as recorder:
        recorder.begin(written.servo, written.target)
        go.clear()
        given, image = 0, np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
        while recorder.recorded():
            recorder.write_frame(rs.Frame(given, 0, 0, image=image))
            given += 1
        go.set()
    assert FRAMES_WAITING < given <= FRAMES_WAITING + 5
    assert "too slow" in recorder.failed


def test_a_full_disk_is_noticed_through_the_thread(written: Written, tmp_path: Path) -> None:
    with ThreadedRecorder(
        Recorder(tmp_path / "r.mcap", {}, open_file=lambda path: Full(path, 20_000))
    ) as recorder:
        recorder.begin(written.servo, written.target)
        for tick in written.ticks:
            recorder.write(tick)
    assert "No space left" in recorder.failed


def test_an_error_in_the_thread_is_told_and_not_raised(written: Written, tmp_path: Path) -> None:
    with ThreadedRecorder(Recorder(tmp_path / "record.mcap", {})) as recorder:
        recorder.begin(written.servo, written.target)
        recorder.write(written.ticks[0])
        recorder.write(replace(written.ticks[1], applied=np.zeros(4)))
    assert "ValueError" in recorder.failed
    rows = reader.read(tmp_path)
    assert len(rows.time) == 1 and not rows.complete


def test_a_record_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(rs.UnusableFile, match=r"nothing\.mcap"):
        reader.read(tmp_path / "nothing.mcap")
    with pytest.raises(rs.UnusableFile, match=r"record\.mcap"):
        reader.read(tmp_path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(rs.UnusableFile, match="not a file"):
        reader.read(tmp_path / "pipe")


def test_phase_cause_and_way_out_stand_in_the_record_in_words_under_crtk_s_name(
    written: Written,
) -> None:
    changes = [written.ticks[0].state.words]
    for tick in written.ticks:
        if tick.state.words != changes[-1]:
            changes.append(tick.state.words)
    with AnyReader([written.folder]) as bag:
        chosen = [
            connection for connection in bag.connections if connection.topic == "operating_state"
        ]
        told = [
            bag.deserialize(data, chosen[0].msgtype)
            for _, _, data in bag.messages(connections=chosen)
        ]
    assert [message.substate for message in told] == changes
    assert {message.state for message in told} == {"ENABLED"}
    assert [message.is_busy for message in told] == [False, True, True]
    paused = ros2.encode_operating_state(5, rs.Mode(rs.Phase.PAUSED, rs.Cause.STALE))
    assert b"PAUSED\0" in paused and rs.Cause.STALE.words.encode() in paused


@pytest.mark.parametrize("version", range(len(ros2.TICKS)))
def test_ticks_as_every_version_wrote_them_are_computed_again_and_what_they_lack_is_not_known(
    written: Written, version: int
) -> None:
    record, kind = reader.read(written.folder), list(ros2.TICKS.values())[version]
    rows: list[bytes] = []
    for tick in written.ticks:
        now = np.frombuffer(ros2.encode_tick(tick)[: ros2.TICK.itemsize], ros2.TICK)
        then = np.zeros(1, kind)
        for name in kind.names or ():
            then[name] = now[name]
        rows.append(then.tobytes())
    ticks = ros2.tick_columns(kind, rows)
    assert set(ticks) == set(record.ticks) & set(ros2.TICK.names or ())
    lacking = {name for name, column in ticks.items() if np.isnan(column).all()}
    assert lacking >= {name for names in LATER[version:] for name in names}
    assert recompute(replace(record, ticks={**record.ticks, **ticks})).same


def test_the_sizes_of_the_markers_come_back(written: Written, tmp_path: Path) -> None:
    tick = written.ticks[5]
    told = replace(tick, seen=replace(tick.seen, sizes=np.array([9.5, np.nan])))
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(written.servo, written.target)
        recorder.write(told)
    np.testing.assert_array_equal(reader.read(tmp_path).ticks["sizes"], [[9.5, np.nan]])
