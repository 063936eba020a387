"""What a user's own estimator remembers is recorded, exported and compared; its replay is the same
bit for bit, and says when its source has changed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import rcmservo as rs
from conftest import ROOT, Laboratory
from rcmservo.app.export import arrays
from rcmservo.app.export import write as export
from rcmservo.config.own_code import named, source
from rcmservo.record import memory, reader
from rcmservo.record.recompute import recompute
from rcmservo.record.ros2_messages import decode_memory, encode_memory
from rcmservo.record.writer import Recorder

NAME = "own_rls:RLS"


@pytest.fixture
def RLS(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The estimator of the example, in a file of its own."""
    text = (ROOT / "examples/02_own_estimator.py").read_text()
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "own_rls.py").write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(__import__("sys").modules, "own_rls", raising=False)
    return named(NAME)


def recorded(lab: Laboratory, folder: Path, *estimators: rs.Estimator) -> Path:
    """Records a second with each estimator, one after the other."""
    folder.mkdir()
    with Recorder(folder / reader.RECORD, {"versions": {"rcmservo": "?"}}) as recorder:
        for estimator in estimators:
            servo = lab.servo(estimator=estimator)
            recorder.begin(servo, lab.target)
            for tick in rs.run(lab.plant, servo, lab.target, 1.0):
                recorder.write(tick)
        assert not recorder.failed
    return folder


def test_its_memory_is_kept_beside_every_tick_and_computed_again_bit_for_bit(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = recorded(lab, tmp_path / "run", RLS(forgetting=0.9))
    again = recompute(folder, own={NAME: RLS})
    assert again.same and not again.open_loop and not again.changed
    kept = again.then.ticks["memory"]
    assert kept.shape == (len(again.then.time), 16) and np.abs(kept[-1]).max() > 0.0
    np.testing.assert_array_equal(kept[:, :16], again.now.ticks["memory"])


def test_other_settings_give_another_memory_and_the_comparison_says_so(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = recorded(lab, tmp_path / "run", RLS(forgetting=0.9))
    servo = lab.servo(estimator=RLS(forgetting=0.8))
    again = recompute(folder, servo)
    assert again.open_loop and "memory" in again.differs


def test_it_is_not_computed_again_unless_it_is_named(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = recorded(lab, tmp_path / "run", RLS())
    with pytest.raises(rs.UnusableFile, match=f"estimator.kind .* got '{NAME}'"):
        recompute(folder)


def test_a_source_that_has_changed_is_told(RLS: Any, lab: Laboratory, tmp_path: Path) -> None:
    folder = recorded(lab, tmp_path / "run", RLS())
    assert reader.read(folder).stages[0].source == source(RLS())
    code = tmp_path / "code/own_rls.py"
    code.write_text(code.read_text() + "# a word more\n")
    again = recompute(folder, own={NAME: RLS})
    assert again.same and again.changed == f"the source of {NAME} has changed since"
    assert again.changed in again.words


def test_a_stage_of_ours_beside_one_of_a_user_keeps_nothing(
    RLS: Any, lab: Laboratory, tmp_path: Path
) -> None:
    folder = recorded(lab, tmp_path / "run", rs.FlowEstimator(), RLS())
    again = recompute(folder, own={NAME: RLS})
    second = again.then.stages[1].first
    assert again.same and np.isnan(again.then.ticks["memory"][:second]).all()
    assert np.isfinite(again.then.ticks["memory"][second:]).all()


def test_it_is_exported_and_read_by_others(RLS: Any, lab: Laboratory, tmp_path: Path) -> None:
    folder = recorded(lab, tmp_path / "run", RLS())
    (tmp_path / "out").mkdir()
    export(folder, tmp_path / "out")
    titles = (tmp_path / "out/ticks.csv").read_text().splitlines()[0].split(",")
    assert [f"memory_{i} [own]" for i in range(1, 17)] == [
        title for title in titles if title.startswith("memory")
    ]
    rows = reader.read(folder)
    assert arrays(rows)["memory"].shape == (len(rows.time), 16)
    with AnyReader([folder]) as bag:
        chosen = [one for one in bag.connections if one.topic == memory.TOPIC]
        told = [bag.deserialize(data, chosen[0].msgtype) for _, _, data in bag.messages(chosen)]
    np.testing.assert_array_equal([one.numbers for one in told], rows.ticks["memory"])


@pytest.mark.parametrize("data", [b"", b"\0" * 27, b"\0" * 20 + b"\2\0\0\0" + b"\0" * 12])
def test_a_message_that_holds_other_numbers_than_it_says_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"Memory|encapsulation"):
        decode_memory(data)


@pytest.mark.parametrize("padding", [b"", bytes(4)])
def test_a_memory_of_no_numbers_is_read_as_it_was_written_before_and_now(padding: bytes) -> None:
    assert decode_memory(encode_memory(5, np.empty(0)) + padding).shape == (0,)
