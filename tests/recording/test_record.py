"""A record gives back the written values bit for bit, and opens in other software."""

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
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.recording import reader
from rcmservo.recording import ros2_messages as ros2
from rcmservo.recording.replay import replay_record
from rcmservo.recording.tick_schema import ADDED_COLUMNS
from rcmservo.recording.writer import (
    MAX_QUEUED_FRAMES,
    MAX_QUEUED_MESSAGES,
    Recorder,
    ThreadedRecorder,
)
from rcmservo.tracking import PointMarkers


@dataclass
class RecordedRun:
    """Ticks of a run of three seconds, and the folder of its record."""

    folder: Path
    ticks: list[rs.Tick]
    servo: rs.Servo
    target: rs.Target

    @property
    def path(self) -> Path:
        return self.folder / reader.RECORD


def record_run(folder: Path, **settings: Any) -> RecordedRun:
    rig = rs.sim.Rig(1, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0), **settings)
    rig.move_to_target()
    target = rs.teach(plant, frames=30)
    rig.go_home()
    run = RecordedRun(folder, [], servo, target)
    with Recorder(run.path, {"seed": 1}) as recorder:
        recorder.begin(servo, target)
        for tick in rs.servo_ticks(plant, servo, target, duration=3.0):
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
            run.ticks.append(tick)
    return run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return record_run(tmp_path_factory.mktemp("record"))


@pytest.fixture(scope="module")
def run_of_rule_21(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return record_run(tmp_path_factory.mktemp("record"), estimator=ProjectionEstimator())


def expected_values(tick: rs.Tick) -> dict[str, Any]:
    """Return the values that a record must hold of a tick, by column name."""
    observation, state = tick.observation, tick.state
    return {
        "now": observation.now,
        "q": observation.q,
        "q_time": observation.q_time,
        "enabled": observation.enabled,
        "applied_at_observation": observation.applied,
        "frame": observation.frame,
        "exposure": observation.exposure,
        "arrival": observation.arrival,
        "q_exposure": observation.q_exposure,
        "points": observation.points,
        "sizes": observation.sizes,
        "recorded": observation.recorded,
        "accepted_frame": state.accepted_frame,
        "since": state.mode.since,
        "accepted_frames": state.mode.accepted_frames,
        "explored": state.explored,
        "o_c": state.o_c,
        "p1": state.p1,
        "y": state.y,
        "rcm_condition": state.estimation.estimate.rcm_condition,
        "delta": state.delta,
        "predicted_delta": state.estimation.estimate.predicted_delta,
        "J_hat": state.J_hat,
        "condition": state.condition,
        "v": state.v,
        "a_hat": getattr(state.estimation.memory, "a_hat", np.full(9, np.nan)),
        "latency": state.monitor.latency,
        "period": state.monitor.frame_period,
        "command": state.command.rates,
        "command_number": state.command.number,
        "command_time": state.command.time,
        "command_deadline": state.command.deadline,
        "command_enabled": state.command.enabled,
        "applied": tick.applied,
        "jog": tick.jog,
        "quality": tick.observation.quality,
        "pose_bound": state.pose_bound,
        "bound_parts": state.bound_parts,
        "resting_rates": state.resting_rates,
    }


def expected_names(tick: rs.Tick) -> dict[str, str]:
    mode = tick.state.mode
    names = {"phase": mode.phase, "cause": mode.cause, "action": mode.action}
    names |= {"request": tick.request, "dropped": tick.observation.drop_reason}
    return {name: value.name for name, value in names.items()}


@pytest.mark.parametrize("which", ["run", "run_of_rule_21"])
def test_every_number_and_name_of_a_tick_is_read_back_bit_for_bit(
    which: str, request: pytest.FixtureRequest
) -> None:
    """The estimator's memory is â, or its recorded numbers."""
    run: RecordedRun = request.getfixturevalue(which)
    rows = reader.read_record(run.folder)
    assert rows.complete and rows.missing == ""
    assert rows.about == {"seed": 1}
    assert len(rows.time) == len(run.ticks) == 300
    assert {"IDLE", "ACQUIRE", "SERVO"} <= set(rows.phase)
    for i, tick in enumerate(run.ticks):
        expected = expected_values(tick)
        memory = run.servo.estimator.recorded_numbers(tick.state.estimation.memory)
        if memory is not None:
            expected["memory"] = memory
        assert set(expected) | {"model"} == set(rows.ticks)
        for name, value in expected.items():
            column = rows.ticks[name]
            assert (
                column[i].tobytes()
                == np.ravel(value).astype(column.dtype, casting="safe").tobytes()
            ), name
        assert {name: column[i] for name, column in rows.words.items()} == expected_names(tick)
    assert (rows.truth["p2"] == 2.0).all() and len(rows.truth["p2"]) == 300


def test_the_model_column_is_the_prediction_of_the_estimate(run: RecordedRun) -> None:
    state, rows = run.ticks[200].state, reader.read_record(run.path)
    predicted = run.servo.estimator.predict(state.estimation.memory, run.servo.tool, state.p1)
    np.testing.assert_array_equal(rows.ticks["model"][200], predicted)


def test_integers_beyond_float_precision_are_read_back(run: RecordedRun, tmp_path: Path) -> None:
    tick, now = run.ticks[100], 2**62 + 1
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(run.servo, run.target)
        recorder.write(
            replace(tick, observation=replace(tick.observation, now=now, exposure=now - 3))
        )
    rows = reader.read_record(tmp_path)
    assert (rows.ticks["now"][0, 0], rows.ticks["exposure"][0, 0]) == (now, now - 3)


def test_a_stage_holds_the_whole_servo_and_its_target(run: RecordedRun) -> None:
    (stage,) = reader.read_record(run.folder).stages
    assert (stage.first, stage.origin) == (0, -1)
    np.testing.assert_array_equal(stage.target.points, run.target.points)
    np.testing.assert_array_equal(stage.target.q, run.target.q)
    assert stage.servo["estimator"]["kind"] == "dlt"
    assert stage.servo["rate"] == 100.0


def test_a_later_stage_holds_its_origin(run: RecordedRun, tmp_path: Path) -> None:
    ticks, servo, other_target = run.ticks, run.servo, replace(run.target)
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(servo, run.target)
        recorder.write(ticks[0])
        recorder.write(ticks[1])
        recorder.begin(servo, run.target, ticks[1].state)
        recorder.write(ticks[0])
        recorder.begin(servo, other_target, ticks[1].state)
        recorder.begin(servo, other_target, ticks[2].state)
    stages = reader.read_record(tmp_path).stages
    assert [stage.first for stage in stages] == [0, 2, 3, 3]
    assert [stage.origin for stage in stages] == [-1, 0, 0, -2]


def test_times_continue_when_a_stage_restarts_them(run: RecordedRun, tmp_path: Path) -> None:
    later = [
        replace(tick, observation=replace(tick.observation, now=tick.observation.now + 10**10))
        for tick in run.ticks[:3]
    ]
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        for stage in (run.ticks[:3], later):
            recorder.begin(run.servo, run.target)
            for tick in stage:
                recorder.write(tick)
    np.testing.assert_allclose(
        reader.read_record(tmp_path).time, [0.0, 0.01, 0.02, 10.0, 10.01, 10.02], atol=2e-3
    )


def test_another_decoder_reads_the_same_ticks_and_joints(run: RecordedRun) -> None:
    rows = reader.read_record(run.folder)
    count = 0
    with run.path.open("rb") as file:
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
                assert message.log_time == run.ticks[count].time
                stamp = decoded.header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == run.ticks[count].observation.now
                count += 1
    assert count == 300


def test_a_run_is_a_ros_2_bag_with_joints_in_si_units(run: RecordedRun) -> None:
    joints: dict[str, list[Any]] = {
        "measured_js": [],
        "servo_jv": [],
        "rcmservo/tick": [],
        "rcmservo/about": [],
    }
    with AnyReader([run.folder]) as bag:
        assert {c.topic: c.msgtype for c in bag.connections}[
            "measured_js"
        ] == "sensor_msgs/msg/JointState"
        for connection, _, raw in bag.messages():
            if connection.topic in joints:
                joints[connection.topic].append(bag.deserialize(raw, connection.msgtype))
    tick = run.ticks[250]
    measured, commanded = joints["measured_js"][250], joints["servo_jv"][250]
    assert measured.name == commanded.name == ["theta", "phi", "rho"]
    assert measured.position == pytest.approx(tick.observation.q * [1.0, 1.0, 1e-3])
    assert commanded.velocity == pytest.approx(tick.state.command.rates * [1.0, 1.0, 1e-3])
    assert len(measured.velocity) == len(commanded.position) == len(measured.effort) == 0
    assert joints["rcmservo/tick"][250].phase == tick.state.phase.name
    np.testing.assert_array_equal(joints["rcmservo/tick"][250].j_hat, tick.state.J_hat.ravel())
    assert json.loads(joints["rcmservo/about"][0].data) == {"seed": 1}


def test_unknown_joints_are_left_out_of_joint_states() -> None:
    names = "theta", "phi", "rho"
    known, unknown = (ros2.encode_positions(names, 5, q) for q in (np.ones(3), np.full(3, np.nan)))
    decode = DecoderFactory().decoder_for("cdr", _schema("sensor_msgs/msg/JointState"))
    assert decode is not None
    assert len(decode(known).position) == 3
    assert len(decode(unknown).position) == 0


def _schema(name: str) -> Any:
    from mcap.records import Schema

    return Schema(id=1, name=name, encoding="ros2msg", data=ros2.DEFINITIONS[name].encode())


def test_frames_are_read_back_with_their_exposure(run: RecordedRun, tmp_path: Path) -> None:
    rig = rs.sim.Rig(1, replace(rs.sim.Rig(1, pictures=False).settings, width=160, height=120))
    rig.clock.wait_until(200_000_000)
    frame = rig.camera.latest()
    assert frame is not None and frame.image is not None
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(run.servo, run.target)
        recorder.write_frame(frame)
        recorder.write_frame(rs.Frame(7, -5, 0, image=frame.image))
    assert reader.read_record(tmp_path).complete
    (first, picture), (second, _) = reader.iterate_frames(tmp_path)
    assert (first, second) == (frame.exposure, -5)
    assert picture.shape == frame.image.shape
    assert np.abs(picture.astype(int) - frame.image).mean() < 3.0
    with AnyReader([tmp_path]) as bag:
        images = [
            bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages() if "image" in c.topic
        ]
    assert images[0].format == "jpeg" and images[0].data[:3].tobytes() == b"\xff\xd8\xff"


class FullDisk:
    """Disk with a limited capacity in bytes."""

    def __init__(self, path: Path, capacity: int) -> None:
        self._file, self._capacity = path.open("xb", buffering=0), capacity

    def write(self, data: memoryview) -> int | None:
        if not self._capacity:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = self._file.write(data[: self._capacity])
        self._capacity -= count or 0
        return count

    def close(self) -> None:
        self._file.close()


@pytest.mark.parametrize("capacity", [0, 5, 20_000, 60_000])
def test_a_full_disk_raises_nothing_and_keeps_the_written_part(
    capacity: int, run: RecordedRun, tmp_path: Path
) -> None:
    path = tmp_path / "record.mcap"
    with Recorder(path, {"seed": 1}, open_file=lambda path: FullDisk(path, capacity)) as recorder:
        recorder.begin(run.servo, run.target)
        for tick in run.ticks:
            recorder.write(tick)
        assert not recorder.recorded()
    assert "No space left" in recorder.failed and "record.mcap" in recorder.failed
    assert path.stat().st_size == capacity
    if capacity < 10_000:
        with pytest.raises(rs.UnusableFile):
            reader.read_record(path)
        return
    rows = reader.read_record(path)
    assert not rows.complete
    assert len(rows.time) > 5
    np.testing.assert_array_equal(
        rows.ticks["q"], [tick.observation.q for tick in run.ticks[: len(rows.time)]]
    )


class SlowDisk(FullDisk):
    """Disk that takes a hundred bytes per write, and none when it is full."""

    def write(self, data: memoryview) -> int | None:
        return super().write(data[:100]) if self._capacity else 0


def test_short_writes_give_the_same_record(run: RecordedRun, tmp_path: Path) -> None:
    path = tmp_path / "record.mcap"
    with Recorder(path, {"seed": 1}, open_file=lambda path: SlowDisk(path, 10**9)) as recorder:
        recorder.begin(run.servo, run.target)
        for tick in run.ticks:
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
    assert recorder.recorded()
    assert path.read_bytes() == run.path.read_bytes()


def test_a_write_of_zero_bytes_counts_as_a_full_disk(run: RecordedRun, tmp_path: Path) -> None:
    with Recorder(
        tmp_path / "record.mcap", {}, open_file=lambda path: SlowDisk(path, 5000)
    ) as recorder:
        recorder.begin(run.servo, run.target)
        for tick in run.ticks[:50]:
            recorder.write(tick)
    assert "nothing more can be written" in recorder.failed


def test_a_file_size_limit_counts_as_a_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "record.mcap"
    code = f"""
import resource
from pathlib import Path
import numpy as np
import rcmservo as rs
from rcmservo.recording.writer import Recorder
with Recorder(Path({str(path)!r}), {{"seed": 1}}) as recorder:
    room = recorder.path.stat().st_size + 100
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0))
    recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))
    print(recorder.failed)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "cannot be written" in out.stdout
    assert reader.read_record(tmp_path).about == {"seed": 1}


def test_a_run_pauses_when_its_record_fails(tmp_path: Path) -> None:
    rig = rs.sim.Rig(1, pictures=False)
    recorder = Recorder(tmp_path / "record.mcap", {}, open_file=lambda path: FullDisk(path, 30_000))
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock, recorder.recorded)
    target = rs.teach(plant, frames=3)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    with recorder:
        recorder.begin(servo, target)
        for tick in rs.servo_ticks(plant, servo, target, duration=3.0):
            recorder.write(tick)
    assert (tick.state.phase, tick.state.cause) == (rs.Phase.PAUSED, rs.Cause.NOT_RECORDED)


def test_a_killed_process_loses_only_the_last_ticks(run: RecordedRun, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "record.mcap", {})
    recorder.begin(run.servo, run.target)
    for count, tick in enumerate(run.ticks):
        recorder.write(tick)
        if count % 37 == 0:
            size = recorder.path.stat().st_size
            copy = tmp_path / "copy.mcap"
            copy.write_bytes(recorder.path.read_bytes())
            assert copy.stat().st_size == size
            rows = reader.read_record(copy)
            assert not rows.complete and "not ended" in rows.missing
            assert len(rows.time) >= count + 1 - 20
    recorder.close()


def test_an_existing_record_is_not_overwritten(run: RecordedRun) -> None:
    before = run.path.read_bytes()
    with pytest.raises(rs.UnusableFile, match="exists"):
        Recorder(run.path, {})
    assert run.path.read_bytes() == before


def test_a_thread_writes_the_same_record(run: RecordedRun, tmp_path: Path) -> None:
    with ThreadedRecorder(Recorder(tmp_path / "record.mcap", {"seed": 1})) as recorder:
        recorder.begin(run.servo, run.target)
        for tick in run.ticks:
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
    assert recorder.recorded()
    assert (tmp_path / "record.mcap").read_bytes() == run.path.read_bytes()


class BlockedDisk:
    """Disk that blocks each write until an event."""

    def __init__(self, path: Path, unblocked: threading.Event) -> None:
        self._file, self._unblocked = path.open("xb", buffering=0), unblocked

    def write(self, data: memoryview) -> int | None:
        self._unblocked.wait(30.0)
        return self._file.write(data)

    def close(self) -> None:
        self._file.close()


def test_a_blocked_disk_never_delays_the_loop(run: RecordedRun, tmp_path: Path) -> None:
    unblocked = threading.Event()
    unblocked.set()
    path = tmp_path / "record.mcap"
    with ThreadedRecorder(
        Recorder(path, {}, open_file=lambda path: BlockedDisk(path, unblocked))
    ) as recorder:
        recorder.begin(run.servo, run.target)
        unblocked.clear()
        count_written = 0
        while recorder.recorded():
            recorder.write(run.ticks[count_written % 300])
            count_written += 1
        recorder.write(run.ticks[0])
        unblocked.set()
    assert MAX_QUEUED_MESSAGES <= count_written <= MAX_QUEUED_MESSAGES + 20
    assert "too slow" in recorder.failed
    rows = reader.read_record(path)
    assert not rows.complete
    assert count_written - MAX_QUEUED_MESSAGES - 10 <= len(rows.time) <= count_written


def test_the_number_of_queued_frames_is_bounded(run: RecordedRun, tmp_path: Path) -> None:
    unblocked = threading.Event()
    unblocked.set()
    with ThreadedRecorder(
        Recorder(tmp_path / "r.mcap", {}, open_file=lambda path: BlockedDisk(path, unblocked))
    ) as recorder:
        recorder.begin(run.servo, run.target)
        unblocked.clear()
        count_given, random = 0, np.random.default_rng(0)
        image = random.integers(0, 255, (60, 80, 3)).astype(np.uint8)
        while recorder.recorded():
            recorder.write_frame(rs.Frame(count_given, 0, 0, image=image))
            count_given += 1
        unblocked.set()
    assert MAX_QUEUED_FRAMES < count_given <= MAX_QUEUED_FRAMES + 5
    assert "too slow" in recorder.failed


def test_a_full_disk_is_noticed_across_the_thread(run: RecordedRun, tmp_path: Path) -> None:
    with ThreadedRecorder(
        Recorder(tmp_path / "r.mcap", {}, open_file=lambda path: FullDisk(path, 20_000))
    ) as recorder:
        recorder.begin(run.servo, run.target)
        for tick in run.ticks:
            recorder.write(tick)
    assert "No space left" in recorder.failed


def test_an_error_in_the_thread_is_reported_and_not_raised(
    run: RecordedRun, tmp_path: Path
) -> None:
    with ThreadedRecorder(Recorder(tmp_path / "record.mcap", {})) as recorder:
        recorder.begin(run.servo, run.target)
        recorder.write(run.ticks[0])
        recorder.write(replace(run.ticks[1], applied=np.zeros(4)))
    assert "ValueError" in recorder.failed
    rows = reader.read_record(tmp_path)
    assert len(rows.time) == 1 and not rows.complete


def test_a_missing_record_is_named(tmp_path: Path) -> None:
    with pytest.raises(rs.UnusableFile, match=r"nothing\.mcap"):
        reader.read_record(tmp_path / "nothing.mcap")
    with pytest.raises(rs.UnusableFile, match=r"record\.mcap"):
        reader.read_record(tmp_path)


def test_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(rs.UnusableFile, match="not a file"):
        reader.read_record(tmp_path / "pipe")


def test_operating_states_hold_phase_cause_and_recovery_in_words(
    run: RecordedRun,
) -> None:
    changes = [run.ticks[0].state.text]
    for tick in run.ticks:
        if tick.state.text != changes[-1]:
            changes.append(tick.state.text)
    with AnyReader([run.folder]) as bag:
        connections = [
            connection for connection in bag.connections if connection.topic == "operating_state"
        ]
        messages = [
            bag.deserialize(data, connections[0].msgtype)
            for _, _, data in bag.messages(connections=connections)
        ]
    assert [message.substate for message in messages] == changes
    assert {message.state for message in messages} == {"ENABLED"}
    assert [message.is_busy for message in messages] == [False, True, True]
    paused = ros2.encode_operating_state(5, rs.Mode(rs.Phase.PAUSED, rs.Cause.STALE))
    assert b"PAUSED\0" in paused and rs.Cause.STALE.text.encode() in paused


@pytest.mark.parametrize("version", range(len(ros2.TICKS)))
def test_ticks_of_every_version_are_replayed_with_missing_columns_unknown(
    run: RecordedRun, version: int
) -> None:
    record, layout = reader.read_record(run.folder), list(ros2.TICKS.values())[version]
    rows: list[bytes] = []
    for tick in run.ticks:
        now = np.frombuffer(ros2.encode_tick(tick)[: ros2.TICK.itemsize], ros2.TICK)
        then = np.zeros(1, layout)
        for name in layout.names or ():
            then[name] = now[name]
        rows.append(then.tobytes())
    ticks = ros2.decode_tick_columns(layout, rows)
    assert set(ticks) == set(record.ticks) & set(ros2.TICK.names or ())
    missing = {name for name, column in ticks.items() if np.isnan(column).all()}
    assert missing >= {name for names in ADDED_COLUMNS[version:] for name in names}
    assert replay_record(replace(record, ticks={**record.ticks, **ticks})).same


def test_the_sizes_of_the_markers_are_read_back(run: RecordedRun, tmp_path: Path) -> None:
    tick = run.ticks[5]
    changed = replace(tick, observation=replace(tick.observation, sizes=np.array([9.5, np.nan])))
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(run.servo, run.target)
        recorder.write(changed)
    np.testing.assert_array_equal(reader.read_record(tmp_path).ticks["sizes"], [[9.5, np.nan]])
