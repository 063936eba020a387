"""A record gives back what was written, up to where it was cut, and never wrong data for right."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

import rcmservo as rs
from rcmservo import record
from rcmservo.tracking import PointMarkers


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[rs.Tick], rs.Servo]:
    rig = rs.sim.Rig(1, pictures=False)
    plant = rs.Plant(rig.mechanism, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(mechanism=rs.SphericalRcm(), tool=rs.RigidTool(spacing=30.0))
    target = rs.teach(plant)
    path = tmp_path_factory.mktemp("record") / "record.mcap"
    ticks = []
    with record.Recorder(path, servo, {"seed": 1}) as recorder:
        for tick in rs.run(plant, servo, target, duration=3.0):
            recorder.write(tick)
            recorder.write_truth(tick.time, np.ones(3), np.full(3, 2.0), 0.5)
            ticks.append(tick)
    return path, ticks, servo


def test_every_number_comes_back_bit_for_bit(written: tuple[Path, list[rs.Tick], rs.Servo]) -> None:
    path, ticks, servo = written
    rows = record.read(path)
    assert rows.complete
    assert rows.about == {"seed": 1}
    assert len(rows.time) == len(ticks) == 300
    for i, tick in enumerate(ticks):
        for name, value in record.tick_numbers(tick, servo).items():
            np.testing.assert_array_equal(rows.ticks[name][i], np.ravel(value))
        assert (rows.phase[i], rows.cause[i]) == (tick.state.phase.name, tick.state.cause.name)
    assert (rows.truth["p2"] == 2.0).all()


def test_the_topics_are_ros_2_messages_in_si_units(written: tuple[Path, list[rs.Tick], rs.Servo]) -> None:
    path, ticks, _ = written
    with path.open("rb") as file:
        schemas = {channel.topic: schema for schema, channel, _ in make_reader(file).iter_messages() if schema}
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    assert schemas["measured_js"].name == schemas["servo_jv"].name == "sensor_msgs/msg/JointState"
    positions = [message for topic, _, message in record._messages(path) if topic == "measured_js"]
    assert positions[5].position == pytest.approx(ticks[5].seen.q * [1.0, 1.0, 1e-3])


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_cut_record_is_read_up_to_the_cut(
    share: float, written: tuple[Path, list[rs.Tick], rs.Servo], tmp_path: Path
) -> None:
    whole, data = record.read(written[0]), written[0].read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    rows = record.read(cut)
    assert not rows.complete
    assert len(rows.time) >= (share - 0.3) * len(whole.time)
    np.testing.assert_array_equal(rows.ticks["q"], whole.ticks["q"][: len(rows.time)])


def test_a_flipped_bit_never_gives_wrong_numbers(written: tuple[Path, list[rs.Tick], rs.Servo], tmp_path: Path) -> None:
    whole, data = record.read(written[0]), bytearray(written[0].read_bytes())
    flipped = tmp_path / "flipped.mcap"
    places = np.random.default_rng(0).integers(0, len(data), 40)
    for place in places:
        data[place] ^= 0x10
        flipped.write_bytes(data)
        data[place] ^= 0x10
        rows = record.read(flipped)
        for name, column in rows.ticks.items():
            np.testing.assert_array_equal(column, whole.ticks[name][: len(rows.time)])


def test_a_record_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(rs.UnusableFile, match=r"nothing\.mcap"):
        record.read(tmp_path / "nothing.mcap")
