"""Whatever the bytes of a record: a sentence, or what was written up to the damage; never more
memory than it takes."""

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
from conftest import first_quick
from rcmservo.record import mcap_recovery, reader
from rcmservo.record import ros2_messages as ros2
from rcmservo.record.mcap_recovery import MAGIC, MAX_RECORD
from rcmservo.record.recompute import recompute
from rcmservo.record.ros2_messages import DEFINITIONS, TICK, TOPICS

MIB = 2**20
CHUNK = 6


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Original:
    return original(tmp_path_factory.mktemp("plain"), 1.0, pictures=False)


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Original:
    return original(tmp_path_factory.mktemp("pictured"), 0.2, pictures=True)


@pytest.fixture(scope="module")
def staged_run(tmp_path_factory: pytest.TempPathFactory) -> Original:
    return original(tmp_path_factory.mktemp("staged"), 0.3, pictures=False, stages=3)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "damaged.mcap"


def test_a_record_cut_anywhere_is_read_up_to_the_cut(plain: Original, path: Path) -> None:
    counts = []
    for data in cuts(plain, 997):
        path.write_bytes(data)
        outcome = read(path, plain)
        assert outcome == (SHORT if len(data) > 1000 else outcome) and outcome != WHOLE
        if outcome == SHORT:
            counts.append(len(reader.read(path).time))
    assert counts == sorted(counts)
    assert counts[-1] >= len(plain.rows.time) - 10 and len(set(counts)) > 10


def test_a_cut_record_tells_how_much_is_missing(plain: Original, path: Path) -> None:
    path.write_bytes(plain.data[: len(plain.data) // 2])
    rows = reader.read(path)
    assert f"read up to {rows.time[-1]:.2f} s" in rows.missing
    assert "how much more there was is not known" in rows.missing
    assert str(len(plain.data) // 2) not in rows.missing, (
        "of a file that was cut its size tells nothing"
    )
    assert 0 < rows.unread < 8000
    middle = len(plain.data) // 2
    wrong = bytes([plain.data[middle] ^ 0xFF])
    path.write_bytes(plain.data[:middle] + wrong + plain.data[middle + 1 :])
    rows = reader.read(path)
    assert f"{rows.time[-1]:.2f} s of {plain.rows.time[-1]:.2f} s" in rows.missing
    assert rows.unread > len(plain.data) // 2 - 8000


@pytest.mark.parametrize("which", first_quick(["plain", "pictured"]))
def test_a_flipped_bit_never_gives_wrong_data(
    which: str, path: Path, request: pytest.FixtureRequest
) -> None:
    before: Original = request.getfixturevalue(which)
    outcomes = set()
    for data in flips(before, 400):
        path.write_bytes(data)
        outcomes.add(read(path, before))
    assert {SHORT, WHOLE} <= outcomes


@pytest.mark.parametrize("stride", first_quick([17, 1]))
def test_every_bit_of_every_kind_and_length_may_flip(
    stride: int, staged_run: Original, path: Path
) -> None:
    """A stride of 17 comes to every bit of the 72, over the records of the file."""
    assert len(staged_run.rows.stages) == 3
    outcomes = []
    for data in islice(head_flips(staged_run), 0, None, stride):
        path.write_bytes(data)
        outcomes.append(read(path, staged_run))
    assert len(outcomes) == -(-72 * len(list(heads(staged_run.data))) // stride)
    assert outcomes.count(SHORT) > 0.5 * len(outcomes)


def test_a_chunk_that_is_taken_for_an_index_is_the_damage_up_to_which_is_read(
    staged_run: Original, path: Path
) -> None:
    """Of all chunks: also of one that holds a stage alone, without which ticks would seem to be of
    the stage before."""
    chunks_at = [place for place in heads(staged_run.data) if staged_run.data[place] == CHUNK]
    told = []
    for place in chunks_at:
        data = bytearray(staged_run.data)
        data[place] ^= 1
        path.write_bytes(data)
        told.append(read(path, staged_run))
        if told[-1] == SHORT:
            assert reader.read(path).unread == len(data) - place
    assert told == [REFUSED] + [SHORT] * (len(chunks_at) - 1)


def test_every_bit_of_a_records_start_and_end_may_flip(plain: Original, path: Path) -> None:
    places = [*range(120), *range(len(plain.data) - 120, len(plain.data))]
    for place in places:
        data = bytearray(plain.data)
        data[place] ^= 1 << (place % 8)
        path.write_bytes(data)
        read(path, plain)


def records(data: bytes) -> list[bytes]:
    """The records of an MCAP file."""
    parts, place = [], len(MAGIC)
    while place < len(data) - len(MAGIC):
        end = place + 9 + struct.unpack_from("<Q", data, place + 1)[0]
        parts.append(data[place:end])
        place = end
    return parts


def joined(parts: list[bytes]) -> bytes:
    return MAGIC + b"".join(parts) + MAGIC


@pytest.mark.parametrize(
    "change",
    [
        lambda them: [*them[:5], *them[6:]],
        lambda them: [*them[:5], them[4], *them[5:]],
        lambda them: [*them[:5], them[6], them[5], *them[7:]],
        lambda them: them[:-1],
        lambda them: [*them[:5], b"\x0a" + them[5][1:], *them[6:]],
    ],
    ids=["left out", "repeated", "exchanged", "last left out", "taken for another record"],
)
def test_no_whole_chunk_can_be_missing_or_stand_elsewhere_unnoticed(
    change: Callable[[list[bytes]], list[bytes]], plain: Original, path: Path
) -> None:
    parts = records(plain.data)
    them, end = (
        [p for p in parts if p[0] == CHUNK],
        next(i for i, p in enumerate(parts) if p[0] == 0x0F),
    )
    assert len(them) > 10
    path.write_bytes(joined([parts[0], *change(them), *parts[end:]]))
    assert read(path, plain) == SHORT


@pytest.mark.parametrize("which", [5, -1])
def test_no_chunk_can_be_hidden_in_an_otherwise_sound_file(
    which: int, plain: Original, path: Path
) -> None:
    parts = records(plain.data)
    hidden = [i for i, part in enumerate(parts) if part[0] == CHUNK][which]
    path.write_bytes(joined([*parts[:hidden], b"\x0a" + parts[hidden][1:], *parts[hidden + 1 :]]))
    assert read(path, plain) == SHORT


def test_an_end_that_is_damaged_tells_nothing_of_the_whole(plain: Original, path: Path) -> None:
    parts = records(plain.data)
    chunk = [i for i, part in enumerate(parts) if part[0] == CHUNK][5]
    parts[chunk] = parts[chunk][:-1] + bytes([parts[chunk][-1] ^ 1])
    path.write_bytes(joined(parts))
    assert f" s of {plain.rows.time[-1]:.2f} s" in reader.read(path).missing
    statistics = next(i for i, part in enumerate(parts) if part[0] == 0x0B)
    end = 9 + 8 + 2 + 4 * 4 + 8
    parts[statistics] = (
        parts[statistics][:end] + struct.pack("<Q", 10**12) + parts[statistics][end + 8 :]
    )
    path.write_bytes(joined(parts))
    assert " s of " not in reader.read(path).missing


def test_a_file_that_unpacks_to_far_more_than_it_holds_is_read_to_a_bound(
    plain: Original, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path.write_bytes(plain.data)
    monkeypatch.setattr(mcap_recovery, "FREE_UNPACKED", 0)
    monkeypatch.setattr(mcap_recovery, "MAX_RATIO", 1)
    assert read(path, plain) == SHORT


def test_chunks_alone_are_the_record(plain: Original, path: Path) -> None:
    """The damage above is what stops reading: without any, the same file is whole."""
    parts = records(plain.data)
    path.write_bytes(joined([part for part in parts if part[0] != 0x07]))
    assert len(reader.read(path).time) == len(plain.rows.time)


def chunk(
    content: bytes, size: int | None = None, packed: bytes | None = None, kind: bytes = b"zstd"
) -> bytes:
    """A chunk's record that holds `content`, or claims that it does."""
    packed = zstandard.compress(content) if packed is None else packed
    size = len(content) if size is None else size
    body = (
        struct.pack("<QQQI", 0, 0, size, zlib.crc32(content)) + struct.pack("<I", len(kind)) + kind
    )
    body += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", CHUNK, len(body)) + body


def bomb(claimed: int) -> bytes:
    """A few bytes of zstd that claim to unpack to so many."""
    return struct.pack("<IBQ", 0xFD2FB528, 0xC0, claimed) + b"\x00" + b"\x01\x00\x00"


@pytest.mark.parametrize(
    "data",
    [
        joined([struct.pack("<BQ", CHUNK, 2**63)]),
        joined([struct.pack("<BQ", CHUNK, 2**32 - 1) + bytes(100)]),
        joined([chunk(b"", size=2**62, packed=bomb(2**62))]),
        joined([chunk(b"", size=2**30, packed=bomb(2**30))]),
        joined([chunk(b"", size=100, packed=bomb(2**40))]),
        joined([chunk(bytes(MAX_RECORD), size=100)]),
        joined([chunk(bytes(MAX_RECORD + 1))]),
        joined([chunk(b"\x05" + struct.pack("<Q", MAX_RECORD - 9) + bytes(MAX_RECORD - 9))] * 200),
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
        reader.read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 128 * MIB


def hidden_stage(data: bytes) -> bytes:
    """A file with one bit flipped: the chunk that holds a stage alone is of an unknown kind."""
    place = [place for place in heads(data) if data[place] == CHUNK][1]
    return data[:place] + bytes([CHUNK ^ 0x80]) + data[place + 1 :]


def unchecked_message(data: bytes) -> bytes:
    """A file with a message between its chunks, where no checksum covers it."""
    record = b"\x05" + struct.pack("<QHIQQ", 22 + 4, 1, 0, 0, 0) + b"told"
    place = next(place for place in heads(data) if data[place] == 0x0F)
    return data[:place] + record + data[place:]


@pytest.mark.parametrize("change", [hidden_stage, unchecked_message])
def test_the_stream_reader_of_mcap_reads_such_files_without_an_error(
    change: Callable[[bytes], bytes], staged_run: Original, path: Path
) -> None:
    path.write_bytes(change(staged_run.data))
    with path.open("rb") as file:
        list(StreamReader(file, validate_crcs=True, record_size_limit=MAX_RECORD).records)
    assert read(path, staged_run) == SHORT


def test_the_stream_reader_of_mcap_unpacks_160_mib_where_100_bytes_are_claimed() -> None:
    one_record = b"\x80" + struct.pack("<Q", 160 * MIB) + bytes(160 * MIB)
    packed = zstandard.compress(one_record)
    claims = io.BytesIO(joined([chunk(b"", size=100, packed=packed)]))
    tracemalloc.start()
    with pytest.raises((McapError, ValueError, struct.error)):
        list(StreamReader(claims, validate_crcs=True, record_size_limit=MAX_RECORD).records)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak > 160 * MIB


def test_a_chunk_that_unpacks_to_more_than_any_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_recovery, "FREE_UNPACKED", 2**40)
    data = joined([chunk(bytes(160 * MIB))])
    test_hostile_bytes_are_refused_in_little_memory(data, path)


def forged(contents: list[tuple[str, bytes]], definitions: dict[str, str] | None = None) -> bytes:
    """A file with sound checksums and any messages."""
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
    ("told", "words"),
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
def test_a_record_without_an_end_tells_how_long_the_run_was_to_last_if_it_knows(
    told: str, words: str, path: Path
) -> None:
    data = forged([("rcmservo/about", ros2.encode_text(f'{{"duration_s": {told}}}'))])
    until, unknown = f"it is read up to 0.00 s{words}, ", "how much more there was is not known"
    end = len(MAGIC) + sum(map(len, records(data)[:3]))
    path.write_bytes(data[:end])
    assert reader.read(path).missing == f"the record was not ended: {until}and {unknown}"
    path.write_bytes(data[: end + 3])
    cut = (
        f"the record is damaged or cut off: {until}3 bytes that follow are left out, and {unknown}"
    )
    assert reader.read(path).missing == cut


ABOUT = ("rcmservo/about", ros2.encode_text("{}"))
STAGE = {"origin": -1, "target": {"points": [[0, 0], [1, 1]], "q": [0, 0, 0]}, "servo": {}}


def staged(**changes: object) -> tuple[str, bytes]:
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
        [ABOUT, staged(origin=0)],
        [ABOUT, staged(origin=-3)],
        [ABOUT, staged(origin=True)],
        [ABOUT, staged(target=None)],
        [ABOUT, staged(target={"points": [[0, 0], [1]], "q": [0, 0, 0]})],
        [ABOUT, staged(target={"points": [[0, 0], [1, 1]], "q": ["a", 0, 0]})],
    ],
    ids=lambda contents: contents[-1][0],
)
def test_messages_that_are_not_as_they_should_be_are_refused(
    contents: list[tuple[str, bytes]], path: Path
) -> None:
    path.write_bytes(forged(contents))
    with pytest.raises(rs.UnusableFile, match="cannot be read"):
        reader.read(path)


def test_ticks_of_another_version_are_refused(path: Path) -> None:
    path.write_bytes(forged([ABOUT, ("rcmservo/tick", b"")], {"rcmservo/tick": "float64 x\n"}))
    with pytest.raises(rs.UnusableFile, match="another version"):
        reader.read(path)


def test_a_file_of_others_is_no_record(path: Path) -> None:
    path.write_bytes(forged([("measured_js", b"anything")]))
    with pytest.raises(rs.UnusableFile, match="not a record"):
        reader.read(path)


def test_a_frame_that_is_no_picture_is_refused(path: Path) -> None:
    for data in (
        b"",
        bytes(50),
        ros2.encode_picture(5, b""),
        ros2.encode_picture(5, b"\xff\xd8\xff" + bytes(50) + b"\xff\xd9"),
    ):
        path.write_bytes(forged([ABOUT, ("image_raw/compressed", data)]))
        with pytest.raises(rs.UnusableFile):
            list(reader.frames(path))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(st.sampled_from(sorted(TOPICS)), st.binary(max_size=60)), max_size=5),
    st.booleans(),
)
@example([("rcmservo/stage", ros2.encode_text(json.dumps(STAGE))), ("rcmservo/tick", b"")], True)
def test_any_messages_at_all_are_read_or_refused(
    path: Path, contents: list[tuple[str, bytes]], begun: bool
) -> None:
    path.write_bytes(forged([ABOUT, staged(), *contents] if begun else contents))
    for use in (reader.read, recompute, lambda path: list(reader.frames(path))):
        try:
            use(path)
        except rs.UnusableFile as error:
            assert "\n" not in str(error)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    words=st.lists(st.text(max_size=8), min_size=5, max_size=5),
    fill=st.binary(min_size=8, max_size=8),
)
def test_a_tick_of_any_numbers_and_words_can_be_run_again_or_is_refused(
    path: Path, plain: Original, words: list[str], fill: bytes
) -> None:
    numbers = (fill * TICK.itemsize)[: TICK.itemsize]
    stage = json.dumps(STAGE | {"servo": plain.rows.stages[0].servo})
    tick = numbers + ros2.codec().encode(ros2.NAMES, *words)[4:]
    path.write_bytes(
        forged([ABOUT, ("rcmservo/stage", ros2.encode_text(stage)), ("rcmservo/tick", tick)])
    )
    rows = reader.read(path)
    assert [
        rows.words[name][0] for name in ("phase", "cause", "asks", "request", "dropped")
    ] == words
    with pytest.raises(rs.UnusableFile, match="does not know"):
        recompute(path)


def test_ticks_of_two_versions_in_one_record_are_refused(path: Path) -> None:
    old, *_, new = ros2.TICKS.items()
    with pytest.raises(rs.UnusableFile, match="another version than those before"):
        rows = reader._Rows(path)
        for definition, kind in (old, new):
            data = bytes(kind.itemsize) + ros2.codec().encode(ros2.NAMES, *5 * [""])[4:]
            rows.add(mcap_recovery.Message("rcmservo/tick", definition, 0, data))
