"""The memory of a user-defined estimator is recorded, exported and compared.

Its replay is identical bit for bit, and reports a changed source.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import rcmservo as rs
from conftest import ROOT, Laboratory
from rcmservo.cli.export import convert_to_arrays
from rcmservo.cli.export import export_record as export
from rcmservo.config.user_estimators import hash_source, import_estimator
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.ros2_messages import decode_memory, encode_memory
from rcmservo.recording.writer import Recorder

NAME = "own_rls:RLS"


@pytest.fixture
def RLS(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the estimator of the example from a file of its own."""
    text = (ROOT / "examples/02_own_estimator.py").read_text()
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "own_rls.py").write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(__import__("sys").modules, "own_rls", raising=False)
    return import_estimator(NAME)


def record_run(lab: Laboratory, folder: Path, *estimators: rs.Estimator) -> Path:
    """Record one second with each estimator."""
    folder.mkdir()
    with Recorder(folder / reader.RECORD, {"versions": {"rcmservo": "?"}}) as recorder:
        for estimator in estimators:
            servo = lab.servo(estimator=estimator)
            recorder.begin(servo, lab.target)
            for tick in rs.servo_ticks(lab.plant, servo, lab.target, 1.0):
                recorder.write(tick)
        assert not recorder.failed
    return folder


def test_the_memory_is_recorded_with_every_tick_and_replayed_bit_for_bit(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = record_run(lab, tmp_path / "run", RLS(forgetting=0.9))
    rerun = replay_record(folder, own={NAME: RLS})
    assert rerun.same and not rerun.open_loop and not rerun.changed
    memories = rerun.recorded.ticks["memory"]
    assert memories.shape == (len(rerun.recorded.time), 16) and np.abs(memories[-1]).max() > 0.0
    np.testing.assert_array_equal(memories[:, :16], rerun.recomputed.ticks["memory"])


def test_other_settings_give_a_reported_difference_of_the_memory(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = record_run(lab, tmp_path / "run", RLS(forgetting=0.9))
    servo = lab.servo(estimator=RLS(forgetting=0.8))
    rerun = replay_record(folder, servo)
    assert rerun.open_loop and "memory" in rerun.difference_counts


def test_an_unnamed_estimator_is_not_replayed(RLS: Any, lab: Laboratory, tmp_path: Path) -> None:
    folder = record_run(lab, tmp_path / "run", RLS())
    with pytest.raises(rs.UnusableFile, match=f"estimator.kind .* got '{NAME}'"):
        replay_record(folder)


def test_a_changed_source_is_reported(RLS: Any, lab: Laboratory, tmp_path: Path) -> None:
    folder = record_run(lab, tmp_path / "run", RLS())
    assert reader.read_record(folder).stages[0].source == hash_source(RLS())
    code = tmp_path / "code/own_rls.py"
    code.write_text(code.read_text() + "# a word more\n")
    rerun = replay_record(folder, own={NAME: RLS})
    assert rerun.same and rerun.changed == f"the source of {NAME} has changed since"
    assert rerun.changed in rerun.sentence


def test_a_stage_of_a_built_in_estimator_next_to_a_users_has_no_memory(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = record_run(lab, tmp_path / "run", rs.FlowEstimator(), RLS())
    rerun = replay_record(folder, own={NAME: RLS})
    second = rerun.recorded.stages[1].first
    assert rerun.same and np.isnan(rerun.recorded.ticks["memory"][:second]).all()
    assert np.isfinite(rerun.recorded.ticks["memory"][second:]).all()


def test_the_memory_is_exported_and_readable_by_other_software(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = record_run(lab, tmp_path / "run", RLS())
    (tmp_path / "out").mkdir()
    export(folder, tmp_path / "out")
    titles = (tmp_path / "out/ticks.csv").read_text().splitlines()[0].split(",")
    assert [f"memory_{i} [own]" for i in range(1, 17)] == [
        title for title in titles if title.startswith("memory")
    ]
    rows = reader.read_record(folder)
    assert convert_to_arrays(rows)["memory"].shape == (len(rows.time), 16)
    with AnyReader([folder]) as bag:
        connections = [c for c in bag.connections if c.topic == "rcmservo/memory"]
        messages = [
            bag.deserialize(data, connections[0].msgtype)
            for _, _, data in bag.messages(connections)
        ]
    np.testing.assert_array_equal([message.numbers for message in messages], rows.ticks["memory"])


@pytest.mark.parametrize("data", [b"", b"\0" * 27, b"\0" * 20 + b"\2\0\0\0" + b"\0" * 12])
def test_a_message_with_another_count_than_stated_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"Memory|encapsulation"):
        decode_memory(data)


@pytest.mark.parametrize("padding", [b"", bytes(4)])
def test_an_empty_memory_is_read_from_earlier_and_present_records(padding: bytes) -> None:
    assert decode_memory(encode_memory(5, np.empty(0)) + padding).shape == (0,)
