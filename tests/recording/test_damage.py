"""Any bytes of a record give an error or the messages up to the damage, in bounded memory."""

import io
import json
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest
import zstandard
from damage import REFUSED, SHORT, WHOLE, Original, cuts, flips, head_flips, heads, original, read
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

import rcmservo as rs
from conftest import mark_others_slow
from rcmservo.recording import mcap_recovery, reader
from rcmservo.recording import ros2_messages as ros2
from rcmservo.recording.mcap_recovery import MAGIC, MAX_RECORD_BYTES
from rcmservo.recording.replay import replay_record
from rcmservo.recording.ros2_messages import DEFINITIONS, TICK, TOPICS

MIB = 2**20
CHUNK = 6


@pytest.fixture(scope="module")
def small_record(tmp_path_factory: pytest.TempPathFactory) -> Original:
    return original(tmp_path_factory.mktemp("plain"), 1.0, pictures=False)


@pytest.fixture(scope="module")
def record_with_images(tmp_path_factory: pytest.TempPathFactory) -> Original:
    return original(tmp_path_factory.mktemp("pictured"), 0.2, pictures=True)


@pytest.fixture(scope="module")
def record_with_stages(tmp_path_factory: pytest.TempPathFactory) -> Original:
    return original(tmp_path_factory.mktemp("staged"), 0.3, pictures=False, stages=3)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "damaged.mcap"


def test_a_record_truncated_anywhere_is_read_up_to_the_cut(
    small_record: Original, path: Path
) -> None:
    counts = []
    for data in cuts(small_record, 997):
        path.write_bytes(data)
        outcome = read(path, small_record)
        assert outcome == (SHORT if len(data) > 1000 else outcome) and outcome != WHOLE
        if outcome == SHORT:
            counts.append(len(reader.read_record(path).time))
    assert counts == sorted(counts)
    assert counts[-1] >= len(small_record.rows.time) - 10 and len(set(counts)) > 10


def test_a_truncated_record_reports_the_missing_part(small_record: Original, path: Path) -> None:
    path.write_bytes(small_record.data[: len(small_record.data) // 2])
    rows = reader.read_record(path)
    assert f"read up to {rows.time[-1]:.2f} s" in rows.missing
    assert "how much more there was is not known" in rows.missing
    assert str(len(small_record.data) // 2) not in rows.missing, (
        "the size of a truncated file gives no information"
    )
    assert 0 < rows.unread < 8000
    middle = len(small_record.data) // 2
    flipped = bytes([small_record.data[middle] ^ 0xFF])
    path.write_bytes(small_record.data[:middle] + flipped + small_record.data[middle + 1 :])
    rows = reader.read_record(path)
    assert f"{rows.time[-1]:.2f} s of {small_record.rows.time[-1]:.2f} s" in rows.missing
    assert rows.unread > len(small_record.data) // 2 - 8000


@pytest.mark.parametrize("which", mark_others_slow(["small_record", "record_with_images"]))
def test_a_flipped_bit_never_gives_false_data(
    which: str, path: Path, request: pytest.FixtureRequest
) -> None:
    before: Original = request.getfixturevalue(which)
    outcomes = set()
    for data in flips(before, 250):
        path.write_bytes(data)
        outcomes.add(read(path, before))
    assert {SHORT, WHOLE} <= outcomes


@pytest.mark.parametrize("stride", mark_others_slow([17, 5]))
def test_any_bit_of_any_kind_and_length_may_flip(
    stride: int, record_with_stages: Original, path: Path
) -> None:
    """Strides of 17 and 5 reach each of the 72 bits, spread over the records of the file."""
    assert len(record_with_stages.rows.stages) == 3
    outcomes = []
    for data in islice(head_flips(record_with_stages), 0, None, stride):
        path.write_bytes(data)
        outcomes.append(read(path, record_with_stages))
    assert len(outcomes) == -(-72 * len(list(heads(record_with_stages.data))) // stride)
    assert outcomes.count(SHORT) > 0.5 * len(outcomes)


def test_reading_stops_at_a_chunk_with_the_kind_of_an_index(
    record_with_stages: Original, path: Path
) -> None:
    """Damage each chunk, including one with a stage only.

    Without that stage, ticks would seem to belong to the previous one.
    """
    original_data = record_with_stages.data
    chunks_at = [at for at in heads(original_data) if original_data[at] == CHUNK]
    outcomes = []
    for position in chunks_at:
        data = bytearray(original_data)
        data[position] ^= 1
        path.write_bytes(data)
        outcomes.append(read(path, record_with_stages))
        if outcomes[-1] == SHORT:
            assert reader.read_record(path).unread == len(data) - position
    assert outcomes == [REFUSED] + [SHORT] * (len(chunks_at) - 1)


def test_any_bit_of_a_records_start_and_end_may_flip(small_record: Original, path: Path) -> None:
    positions = [*range(120), *range(len(small_record.data) - 120, len(small_record.data))]
    for position in positions:
        data = bytearray(small_record.data)
        data[position] ^= 1 << (position % 8)
        path.write_bytes(data)
        read(path, small_record)


def records(data: bytes) -> list[bytes]:
    """Return the records of an MCAP file."""
    parts, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        end = position + 9 + struct.unpack_from("<Q", data, position + 1)[0]
        parts.append(data[position:end])
        position = end
    return parts


def joined(parts: list[bytes]) -> bytes:
    return MAGIC + b"".join(parts) + MAGIC


@pytest.mark.parametrize(
    "change",
    [
        lambda chunks: [*chunks[:5], *chunks[6:]],
        lambda chunks: [*chunks[:5], chunks[4], *chunks[5:]],
        lambda chunks: [*chunks[:5], chunks[6], chunks[5], *chunks[7:]],
        lambda chunks: chunks[:-1],
        lambda chunks: [*chunks[:5], b"\x0a" + chunks[5][1:], *chunks[6:]],
    ],
    ids=["left out", "repeated", "exchanged", "last left out", "taken for another record"],
)
def test_a_missing_or_moved_chunk_is_noticed(
    change: Callable[[list[bytes]], list[bytes]], small_record: Original, path: Path
) -> None:
    parts = records(small_record.data)
    chunks, end = (
        [p for p in parts if p[0] == CHUNK],
        next(i for i, p in enumerate(parts) if p[0] == 0x0F),
    )
    assert len(chunks) > 10
    path.write_bytes(joined([parts[0], *change(chunks), *parts[end:]]))
    assert read(path, small_record) == SHORT


@pytest.mark.parametrize("which", [5, -1])
def test_a_hidden_chunk_in_an_otherwise_intact_file_is_noticed(
    which: int, small_record: Original, path: Path
) -> None:
    parts = records(small_record.data)
    hidden = [i for i, part in enumerate(parts) if part[0] == CHUNK][which]
    path.write_bytes(joined([*parts[:hidden], b"\x0a" + parts[hidden][1:], *parts[hidden + 1 :]]))
    assert read(path, small_record) == SHORT


def test_a_damaged_end_gives_no_statistics(small_record: Original, path: Path) -> None:
    parts = records(small_record.data)
    chunk = [i for i, part in enumerate(parts) if part[0] == CHUNK][5]
    parts[chunk] = parts[chunk][:-1] + bytes([parts[chunk][-1] ^ 1])
    path.write_bytes(joined(parts))
    assert f" s of {small_record.rows.time[-1]:.2f} s" in reader.read_record(path).missing
    statistics = next(i for i, part in enumerate(parts) if part[0] == 0x0B)
    end = 9 + 8 + 2 + 4 * 4 + 8
    parts[statistics] = (
        parts[statistics][:end] + struct.pack("<Q", 10**12) + parts[statistics][end + 8 :]
    )
    path.write_bytes(joined(parts))
    assert " s of " not in reader.read_record(path).missing


def test_a_file_that_unpacks_to_far_more_than_its_size_is_read_to_a_bound(
    small_record: Original, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path.write_bytes(small_record.data)
    monkeypatch.setattr(mcap_recovery, "UNPACKED_ALLOWANCE_BYTES", 0)
    monkeypatch.setattr(mcap_recovery, "MAX_COMPRESSION_RATIO", 1)
    assert read(path, small_record) == SHORT


def test_a_record_is_complete_without_its_indices(small_record: Original, path: Path) -> None:
    """The tests above stop at the damage: without damage the same file is complete."""
    parts = records(small_record.data)
    path.write_bytes(joined([part for part in parts if part[0] != 0x07]))
    assert len(reader.read_record(path).time) == len(small_record.rows.time)


def chunk(
    content: bytes, size: int | None = None, packed: bytes | None = None, kind: bytes = b"zstd"
) -> bytes:
    """Return a chunk record with `content`, or one that declares another size or other data."""
    packed = zstandard.compress(content) if packed is None else packed
    size = len(content) if size is None else size
    body = (
        struct.pack("<QQQI", 0, 0, size, zlib.crc32(content)) + struct.pack("<I", len(kind)) + kind
    )
    body += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", CHUNK, len(body)) + body


def zip_bomb(declared: int) -> bytes:
    """Return a few bytes of zstd that declare this unpacked size."""
    return struct.pack("<IBQ", 0xFD2FB528, 0xC0, declared) + b"\x00" + b"\x01\x00\x00"


@pytest.mark.parametrize(
    "data",
    [
        joined([struct.pack("<BQ", CHUNK, 2**63)]),
        joined([struct.pack("<BQ", CHUNK, 2**32 - 1) + bytes(100)]),
        joined([chunk(b"", size=2**62, packed=zip_bomb(2**62))]),
        joined([chunk(b"", size=2**30, packed=zip_bomb(2**30))]),
        joined([chunk(b"", size=100, packed=zip_bomb(2**40))]),
        joined([chunk(bytes(MAX_RECORD_BYTES), size=100)]),
        joined([chunk(bytes(MAX_RECORD_BYTES + 1))]),
        joined(
            [chunk(b"\x05" + struct.pack("<Q", MAX_RECORD_BYTES - 9) + bytes(MAX_RECORD_BYTES - 9))]
            * 200
        ),
        joined([chunk(b"\x03" + struct.pack("<Q", 10) + b"\x01\x00\xff\xff\xff\xff" + bytes(4))]),
        joined([chunk(b"\x05" + struct.pack("<Q", 2) + b"\x01\x00")]),
        joined([chunk(b"\x04" + struct.pack("<Q", 0))]),
        joined([chunk(b"x" * 50, kind=b"lz4", packed=b"x" * 50)]),
        joined([b"\x06" + struct.pack("<Q", 0)]),
        joined([b"\x02" + struct.pack("<QQQI", 20, 2**60, 0, 0)]),
        MAGIC,
        b"",
        b"\x89MCAP1\r\n" + bytes(100),
        bytes(10_000),
    ],
    ids=range(18),
)
def test_hostile_bytes_are_refused_in_little_memory(data: bytes, path: Path) -> None:
    path.write_bytes(data)
    tracemalloc.start()
    with pytest.raises(rs.UnusableFile):
        reader.read_record(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 128 * MIB


def file_with_hidden_stage(data: bytes) -> bytes:
    """Return a file with one flipped bit: the chunk with a stage only has an unknown kind."""
    position = [position for position in heads(data) if data[position] == CHUNK][1]
    return data[:position] + bytes([CHUNK ^ 0x80]) + data[position + 1 :]


def message_without_checksum(data: bytes) -> bytes:
    """Return a file with a message between its chunks, where no checksum covers it."""
    record = b"\x05" + struct.pack("<QHIQQ", 22 + 4, 1, 0, 0, 0) + b"text"
    position = next(position for position in heads(data) if data[position] == 0x0F)
    return data[:position] + record + data[position:]


@pytest.mark.parametrize("change", [file_with_hidden_stage, message_without_checksum])
def test_the_stream_reader_of_mcap_reads_such_files_without_an_error(
    change: Callable[[bytes], bytes], record_with_stages: Original, path: Path
) -> None:
    path.write_bytes(change(record_with_stages.data))
    with path.open("rb") as file:
        list(StreamReader(file, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records)
    assert read(path, record_with_stages) == SHORT


def test_the_stream_reader_of_mcap_unpacks_160_mib_where_100_bytes_are_declared() -> None:
    large_record = b"\x80" + struct.pack("<Q", 160 * MIB) + bytes(160 * MIB)
    packed = zstandard.compress(large_record)
    stream = io.BytesIO(joined([chunk(b"", size=100, packed=packed)]))
    tracemalloc.start()
    with pytest.raises((McapError, ValueError, struct.error)):
        list(StreamReader(stream, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak > 160 * MIB


def test_a_chunk_that_unpacks_to_more_than_the_limit_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_recovery, "UNPACKED_ALLOWANCE_BYTES", 2**40)
    data = joined([chunk(bytes(160 * MIB))])
    test_hostile_bytes_are_refused_in_little_memory(data, path)


def forged_file(
    contents: list[tuple[str, bytes]], definitions: dict[str, str] | None = None
) -> bytes:
    """Return a file with correct checksums and arbitrary messages."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start("ros2")
    channels: dict[str, int] = {}
    counts: dict[str, int] = {}
    for topic, data in contents:
        if topic not in channels:
            text = (definitions or {}).get(topic, DEFINITIONS[TOPICS[topic]])
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(topic, "ros2msg", text.encode())
            )
        counts[topic] = counts.get(topic, -1) + 1
        writer.add_message(channels[topic], 0, data, 0, counts[topic])
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize(
    ("duration", "suffix"),
    [
        ("8.0", " of the planned 8.00 s"),
        ("8", " of the planned 8.00 s"),
        ("true", ""),
        ("-1", ""),
        ("NaN", ""),
        ('"8"', ""),
        ("1" + "0" * 400, ""),
    ],
)
def test_a_record_without_an_end_reports_the_planned_duration_if_known(
    duration: str, suffix: str, path: Path
) -> None:
    data = forged_file([("rcmservo/about", ros2.encode_text(f'{{"duration_s": {duration}}}'))])
    until, unknown = f"it is read up to 0.00 s{suffix}, ", "how much more there was is not known"
    end = len(MAGIC) + sum(map(len, records(data)[:3]))
    path.write_bytes(data[:end])
    assert reader.read_record(path).missing == f"the record was not ended: {until}and {unknown}"
    path.write_bytes(data[: end + 3])
    cut = (
        f"the record is damaged or cut off: {until}3 bytes that follow are left out, and {unknown}"
    )
    assert reader.read_record(path).missing == cut


ABOUT = ("rcmservo/about", ros2.encode_text("{}"))
STAGE = {"origin": -1, "target": {"points": [[0, 0], [1, 1]], "q": [0, 0, 0]}, "servo": {}}


def stage_message(**changes: object) -> tuple[str, bytes]:
    return "rcmservo/stage", ros2.encode_text(json.dumps(STAGE | changes))


@pytest.mark.parametrize(
    "contents",
    [
        [("rcmservo/about", ros2.encode_text("[1]"))],
        [("rcmservo/about", ros2.encode_text("{"))],
        [("rcmservo/about", ros2.encode_text("[" * 100_000))],
        [("rcmservo/about", ros2.encode_text('{"a": ' + "9" * 5000 + "}"))],
        [("rcmservo/about", b"")],
        [("rcmservo/about", b"\0\1\0\0\xff\xff\xff\xff")],
        [ABOUT, ("rcmservo/tick", bytes(TICK.itemsize - 1))],
        [ABOUT, ("rcmservo/tick", bytes(TICK.itemsize + 19))],
        [ABOUT, ("rcmservo/truth", b"")],
        [ABOUT, ("rcmservo/stage", ros2.encode_text("{}"))],
        [ABOUT, stage_message(origin=0)],
        [ABOUT, stage_message(origin=-3)],
        [ABOUT, stage_message(origin=True)],
        [ABOUT, stage_message(target=None)],
        [ABOUT, stage_message(target={"points": [[0, 0], [1]], "q": [0, 0, 0]})],
        [ABOUT, stage_message(target={"points": [[0, 0], [1, 1]], "q": ["a", 0, 0]})],
    ],
    ids=lambda contents: contents[-1][0],
)
def test_malformed_messages_are_refused(contents: list[tuple[str, bytes]], path: Path) -> None:
    path.write_bytes(forged_file(contents))
    with pytest.raises(rs.UnusableFile, match="cannot be read"):
        reader.read_record(path)


def test_ticks_of_another_version_are_refused(path: Path) -> None:
    path.write_bytes(forged_file([ABOUT, ("rcmservo/tick", b"")], {"rcmservo/tick": "float64 x\n"}))
    with pytest.raises(rs.UnusableFile, match="another version"):
        reader.read_record(path)


def test_a_file_of_other_software_is_no_record(path: Path) -> None:
    path.write_bytes(forged_file([("measured_js", b"anything")]))
    with pytest.raises(rs.UnusableFile, match="not a record"):
        reader.read_record(path)


def test_a_frame_that_is_no_image_is_refused(path: Path) -> None:
    for data in (
        b"",
        bytes(50),
        ros2.encode_picture(5, b""),
        ros2.encode_picture(5, b"\xff\xd8\xff" + bytes(50) + b"\xff\xd9"),
    ):
        path.write_bytes(forged_file([ABOUT, ("image_raw/compressed", data)]))
        with pytest.raises(rs.UnusableFile):
            list(reader.iterate_frames(path))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(st.sampled_from(sorted(TOPICS)), st.binary(max_size=60)), max_size=5),
    st.booleans(),
)
@example([("rcmservo/stage", ros2.encode_text(json.dumps(STAGE))), ("rcmservo/tick", b"")], True)
def test_any_messages_are_read_or_refused(
    path: Path, contents: list[tuple[str, bytes]], with_start: bool
) -> None:
    path.write_bytes(forged_file([ABOUT, stage_message(), *contents] if with_start else contents))
    for use in (reader.read_record, replay_record, lambda path: list(reader.iterate_frames(path))):
        try:
            use(path)
        except rs.UnusableFile as error:
            assert "\n" not in str(error)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    words=st.lists(st.text(max_size=8), min_size=5, max_size=5),
    pattern=st.binary(min_size=8, max_size=8),
)
def test_a_tick_of_any_numbers_and_words_is_replayed_or_refused(
    path: Path, small_record: Original, words: list[str], pattern: bytes
) -> None:
    numbers = (pattern * TICK.itemsize)[: TICK.itemsize]
    stage = json.dumps(STAGE | {"servo": small_record.rows.stages[0].servo})
    tick = numbers + ros2.get_codec().encode(ros2.TICK_NAMES, *words)[4:]
    path.write_bytes(
        forged_file([ABOUT, ("rcmservo/stage", ros2.encode_text(stage)), ("rcmservo/tick", tick)])
    )
    rows = reader.read_record(path)
    assert [
        rows.words[name][0] for name in ("phase", "cause", "action", "request", "dropped")
    ] == words
    with pytest.raises(rs.UnusableFile, match="does not know"):
        replay_record(path)


def test_ticks_of_two_versions_in_one_record_are_refused(path: Path) -> None:
    old, *_, new = ros2.TICKS.items()
    with pytest.raises(rs.UnusableFile, match="another version than the ticks before it"):
        rows = reader._RecordBuilder(path)
        for definition, kind in (old, new):
            data = bytes(kind.itemsize) + ros2.get_codec().encode(ros2.TICK_NAMES, *5 * [""])[4:]
            rows.add(mcap_recovery.Message("rcmservo/tick", definition, 0, data))
