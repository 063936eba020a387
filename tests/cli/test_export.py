"""Exported records: every number of the record, for programs without rcmservo."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.cli.cli import main
from rcmservo.cli.export import COLUMN_UNITS, convert_to_arrays
from rcmservo.recording import reader
from rcmservo.recording.foreign import frame_folder as recording
from rcmservo.recording.ros2_messages import TICK, TRUTH_LAYOUT
from rcmservo.recording.tick_schema import TRUTH_COLUMNS
from rcmservo.recording.writer import Recorder
from rcmservo.tracking import ColourMarkers

SERVO = rs.Servo(mechanism=rs.PitchYawRcm(), tool=rs.RigidTool(spacing=30.0))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of 0.8 s with its frames, one of which no tick used."""
    folder = tmp_path_factory.mktemp("run")
    settings = rs.sim.RigSettings(mechanism=rs.PitchYawRcm(), width=320, height=240)
    rig = rs.sim.Rig(1, settings)
    plant = rs.Plant(rig.arm, rig.camera, ColourMarkers(), rig.clock)
    target = rs.Target(np.array([[100.0, 100.0], [120.0, 140.0]]), np.full(3, np.nan))
    newest = -1
    with Recorder(folder / reader.RECORD, {"seed": 1, "name": "é"}) as recorder:
        recorder.begin(SERVO, target)
        for tick in rs.servo_ticks(plant, SERVO, target, 0.8):
            recorder.write(tick)
            recorder.write_truth(np.ones(3), np.full(3, 2.0), 0.5)
            if plant.frame is not None and plant.frame.number > newest:
                newest = plant.frame.number
                recorder.write_frame(plant.frame)
        assert plant.frame is not None
        recorder.write_frame(
            rs.Frame(newest + 1, tick.observation.now, tick.observation.now, plant.frame.image)
        )
    return folder


@pytest.fixture(scope="module")
def exported(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported") / "out"
    assert main(["export", str(run), "--out", str(folder)]) == 0
    return folder


def test_every_column_of_a_record_has_its_units() -> None:
    for units, layout in ((COLUMN_UNITS, TICK), (TRUTH_COLUMNS, TRUTH_LAYOUT)):
        names = [name for name in layout.names or () if layout[name].shape]
        assert {name: (len(parts),) for name, parts in units.items()} == {
            name: layout[name].shape for name in names
        }


def test_the_arrays_are_the_record_bit_for_bit_and_need_no_pickle(
    run: Path, exported: Path
) -> None:
    rows = reader.read_record(run)
    with np.load(exported / "record.npz", allow_pickle=False) as got:
        assert set(got) == set(convert_to_arrays(rows))
        assert got["time"].tobytes() == rows.time.tobytes()
        for name, column in rows.ticks.items():
            assert got[name].dtype == column.dtype and got[name].tobytes() == column.tobytes()
        for name, column in rows.truth.items():
            assert got[f"truth_{name}"].tobytes() == column.tobytes()
        for name, words in rows.words.items():
            assert got[name].tolist() == words
        assert got["stage_target_points"].tobytes() == rows.stages[0].target.points.tobytes()
        assert json.loads(str(got["about"])) == {"seed": 1, "name": "é"}
        assert json.loads(str(got["stage_servo"][0])) == rows.stages[0].servo


def test_arrays_hold_no_objects_and_numpy_needs_no_recent_keyword(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy 2.0 treats every keyword as the name of an array."""
    saved: dict[str, object] = {}
    monkeypatch.setattr(np, "savez_compressed", lambda file, **given: saved.update(given))
    assert main(["export", str(run), "--out", str(tmp_path / "out")]) == 0
    assert list(saved) == list(convert_to_arrays(reader.read_record(run)))
    assert not any(np.asarray(array).dtype.hasobject for array in saved.values())


def test_the_table_has_every_tick_and_loses_no_digit(run: Path, exported: Path) -> None:
    rows = reader.read_record(run)
    with (exported / "ticks.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(rows.time) == 80
    for name, column in (
        ("q_3 [mm]", rows.ticks["q"][:, 2]),
        ("J_hat_d_z [px/mm]", rows.ticks["J_hat"][:, 8]),
        ("truth_p2_x [mm]", rows.truth["p2"][:, 0]),
        ("time [s]", rows.time),
        ("delta_s [rad]", rows.ticks["delta"][:, 0]),
    ):
        got = np.array([float(row[name] or "nan") for row in table])
        np.testing.assert_array_equal(got, column)
    assert [int(row["now [ns]"]) for row in table] == rows.ticks["now"][:, 0].tolist()
    assert [row["phase"] for row in table] == rows.phase
    assert all(None not in row and None not in row.values() for row in table)


def test_exported_frames_are_a_recording_that_replay_reads(
    run: Path, exported: Path, tmp_path: Path
) -> None:
    rows = reader.read_record(run)
    used = sorted(set(rows.ticks["exposure"][rows.ticks["frame"][:, 0] >= 0, 0].tolist()))
    poses = recording.load_recording(exported / "recording", SERVO.mechanism, SERVO.tool)
    assert [pose.time for pose in poses] == pytest.approx(
        [exposure * 1e-9 for exposure in used], abs=1e-9
    )
    for pose, frame, (_, image) in zip(
        poses, recording.iterate_frames(poses), reader.iterate_frames(run), strict=False
    ):
        i = int(np.argmax(rows.ticks["exposure"][:, 0] == round(pose.time * 1e9)))
        np.testing.assert_allclose(pose.q, rows.ticks["q_exposure"][i], rtol=1e-8, atol=1e-9)
        np.testing.assert_array_equal(frame.image, image)
    rig = tmp_path / "rig.toml"
    rig.write_text('[mechanism]\nkind = "pitch-yaw"\n')
    assert main(["replay", str(exported / "recording"), "--rig", str(rig)]) == 0


def test_frames_without_a_tick_are_reported(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(run / reader.RECORD), "--out", str(tmp_path / "out")]) == 0
    assert "80 ticks and" in (out := capsys.readouterr().out)
    assert "left out, because no tick records their joints: 1 frames" in out


def test_a_record_without_truth_and_frames_is_exported(tmp_path: Path) -> None:
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(SERVO, rs.Target(np.ones((2, 2)), np.ones(3)))
    assert main(["export", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["record.npz", "ticks.csv"]
    assert len((tmp_path / "out" / "ticks.csv").read_text().splitlines()) == 1


def test_nothing_is_overwritten(run: Path, exported: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in exported.iterdir()}
    assert main(["export", str(run), "--out", str(exported)]) == 2
    assert before == {path: path.stat().st_mtime_ns for path in exported.iterdir()}
