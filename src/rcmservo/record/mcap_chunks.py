"""The messages of an MCAP file that are certainly as they were written, up to its end or its first
damage.

Only what lies in a chunk counts, because only that carries a checksum. Every message has a number
that rises by one from message to message of its topic, so that none can be missing unnoticed.
Between the chunks stands only what the recorder writes there: a chunk that is taken for anything
else is damage, not something to pass over. No length in the file is believed before it is compared
with what is there, so that reading takes little memory, whatever the bytes.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard

from rcmservo.errors import UnusableFile

MAGIC = b"\x89MCAP0\r\n"
HEADER, CHUNK, MESSAGE_INDEX, DATA_END = 0x01, 0x06, 0x07, 0x0F
SCHEMA, CHANNEL, MESSAGE = 0x03, 0x04, 0x05
FOOTER, STATISTICS = 0x02, 0x0B

LARGEST = 32 * 2**20
"""Largest chunk in bytes, packed or unpacked."""

ROOM = 64 * 2**20
RATIO = 32
"""A file may unpack to ROOM bytes and RATIO times its size: far more than a run's numbers ever
do."""

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_INDEX = struct.Struct("<HI")
_ENTRY = struct.Struct("<QQ")
_CHECKSUM = 4
_FOOTER = struct.Struct("<BQQQI")
_STATISTICS = struct.Struct("<QHIIIIQQI")


class Message(NamedTuple):
    """A message as it was written."""

    topic: str
    """Its channel's name, such as rcmservo/tick."""
    definition: str
    """How messages of its topic are laid out, as ROS 2 writes it; empty where the file does not
    tell."""
    time: int
    """When it was logged, ns since the record's start."""
    data: bytes
    """Its bytes, in CDR."""


class _Damage(Exception):
    """What follows cannot be trusted."""


@dataclass
class Channel:
    """A topic, and how far it has been read."""

    topic: str
    """Its name."""
    definition: str
    """How its messages are laid out; empty where the file does not tell."""
    read: int = 0
    """Messages read so far."""


class FileSummary(NamedTuple):
    """What the end of a file says of the whole."""

    counts: dict[int, int]
    """Messages by the channels' numbers."""
    end: int
    """When the last message was logged, ns since the record's start."""


class Messages:
    """Reads a file once, by iteration; then ``place``, ``complete`` and ``summary`` tell how far it
    could be read.

    ``place`` is the byte up to which the file is sound, of ``size``; ``complete`` means that
    nothing is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size, self.place = 0, 0
        self.complete = False
        self.summary: FileSummary | None = None
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._chunk: Counter[int] = Counter()
        self._room = 0

    @property
    def unread(self) -> int:
        """Bytes of the file that are not read because of damage."""
        return 0 if self.complete else self.size - self.place

    @property
    def where(self) -> tuple[int, int]:
        """Where the message read last is: the byte at which its chunk begins, and its place
        there; see `in_chunk`."""
        return self.place, self._chunk.total() - 1

    def number(self, topic: str) -> int:
        """That of a topic's channel, −1 where none was read so far."""
        return next((n for n, one in self._channels.items() if one.topic == topic), -1)

    def __iter__(self) -> Iterator[Message]:
        if self.path.exists() and not self.path.is_file():
            raise UnusableFile(self.path, "is not a file")
        try:
            with self.path.open("rb") as file:
                self.size = self.path.stat().st_size
                self._room = ROOM + RATIO * self.size
                if file.read(len(MAGIC)) != MAGIC:
                    raise UnusableFile(
                        self.path, "is not a record: it is no MCAP file, or its start is damaged"
                    )
                self.summary = _summary(file, self.size)
                self.place = len(MAGIC)
                yield from self._read(file)
        except OSError as error:
            raise UnusableFile(self.path, f"cannot be read: {error.strerror}") from error

    def _read(self, file: BinaryIO) -> Iterator[Message]:
        """The messages up to the end or to the damage, and then whether they are all that the
        file's end tells of."""
        with suppress(_Damage):
            yield from self._chunks(file)
        read = {number: channel.read for number, channel in self._channels.items() if channel.read}
        self.complete = self.summary is not None and read == self.summary.counts

    def _chunks(self, file: BinaryIO) -> Iterator[Message]:
        """The messages of chunk after chunk."""
        opcode = HEADER
        while opcode != DATA_END and self.size - self.place >= _RECORD.size:
            opcode, body = self._record(file)
            if opcode == CHUNK:
                yield from self._messages(self._unpacked(body))
            elif opcode == MESSAGE_INDEX:
                self._check_index(body)
            self.place += _RECORD.size + len(body)

    def _record(self, file: BinaryIO) -> tuple[int, bytes]:
        """The record at the place: a header, which comes first, a chunk, an index, or the end of
        the data."""
        file.seek(self.place)
        opcode, length = _RECORD.unpack(_exactly(file, _RECORD.size))
        if length > min(self.size - self.place - _RECORD.size, LARGEST):
            raise _Damage
        body = _exactly(file, length)
        if self.place == len(MAGIC):
            sound = opcode == HEADER and _text(body, _text(body, 0)[1])[1] == length
        else:
            sound = opcode in (CHUNK, MESSAGE_INDEX) or (opcode == DATA_END and length == _CHECKSUM)
        if not sound:
            raise _Damage
        return opcode, body

    def content(self, place: int) -> bytes:
        """What the chunk that begins at a byte holds."""
        with self.path.open("rb") as file:
            self.size, self.place = self.path.stat().st_size, place
            self._room = ROOM + RATIO * self.size
            opcode, body = self._record(file)
        if opcode != CHUNK:
            raise _Damage
        return self._unpacked(body)

    def _unpacked(self, record: bytes) -> bytes:
        """A chunk's content, as its checksum says it was written."""
        if len(record) < _CHUNK.size:
            raise _Damage
        _, _, size, checksum = _CHUNK.unpack_from(record)
        compression, place = _text(record, _CHUNK.size)
        packed, end = _bytes(record, place, "<Q")
        self._room -= size
        if (
            end != len(record)
            or size > LARGEST
            or self._room < 0
            or compression not in ("", "zstd")
        ):
            raise _Damage
        data = _decompressed(packed, size) if compression else packed
        if len(data) != size or zlib.crc32(data) != checksum:
            raise _Damage
        return data

    def _check_index(self, record: bytes) -> None:
        """An index must have an entry for every message that the chunk before it holds of a
        channel."""
        if len(record) < _INDEX.size:
            raise _Damage
        number, length = _INDEX.unpack_from(record)
        expected = self._chunk.pop(number, 0) * _ENTRY.size
        if not 0 < length == expected == len(record) - _INDEX.size:
            raise _Damage

    def _messages(self, data: bytes) -> Iterator[Message]:
        """The messages of a chunk; schemas and channels are learnt on the way."""
        self._chunk.clear()
        place, end = 0, len(data)
        while place < end:
            if end - place < _RECORD.size:
                raise _Damage
            opcode, length = _RECORD.unpack_from(data, place)
            place += _RECORD.size
            if length > end - place:
                raise _Damage
            if opcode == MESSAGE:
                yield self._message(data[place : place + length])
            elif opcode == SCHEMA:
                self._learn_schema(data[place : place + length])
            elif opcode == CHANNEL:
                self._learn_channel(data[place : place + length])
            else:
                raise _Damage
            place += length

    def _message(self, record: bytes) -> Message:
        if len(record) < _MESSAGE.size:
            raise _Damage
        number, sequence, time, _ = _MESSAGE.unpack_from(record)
        channel = self._channels.get(number)
        if channel is None or sequence != channel.read:
            raise _Damage
        channel.read += 1
        self._chunk[number] += 1
        return Message(channel.topic, channel.definition, time, record[_MESSAGE.size :])

    def _learn_schema(self, record: bytes) -> None:
        _, place = _text(record, 2)
        _, place = _text(record, place)
        definition, _ = _text(record, place)
        self._schemas[_number(record)] = definition

    def _learn_channel(self, record: bytes) -> None:
        topic, _ = _text(record, 4)
        definition = self._schemas.get(struct.unpack_from("<H", record, 2)[0], "")
        self._channels.setdefault(_number(record), Channel(topic, definition))


class Placed(NamedTuple):
    """A message of a chunk that is read by itself."""

    number: int
    """That of its channel."""
    time: int
    """When it was logged, ns since the record's start."""
    data: bytes
    """Its bytes, in CDR."""


def chunk_places(path: Path) -> list[int]:
    """The bytes at which a file's chunks begin, by their heads alone, up to where the file ends or
    is certainly damaged."""
    places: list[int] = []
    try:
        with path.open("rb", buffering=0) as file:
            size, place = path.stat().st_size, len(MAGIC)
            while size - place >= _RECORD.size:
                file.seek(place)
                opcode, length = _RECORD.unpack(_exactly(file, _RECORD.size))
                whole = length <= min(size - place - _RECORD.size, LARGEST)
                if not whole or opcode not in (HEADER, CHUNK, MESSAGE_INDEX):
                    break
                if opcode == CHUNK:
                    places.append(place)
                place += _RECORD.size + length
    except (OSError, _Damage) as error:
        raise UnusableFile(path, f"cannot be read: {error}") from error
    return places


def in_chunk(path: Path, place: int) -> list[Placed]:
    """The messages of the chunk that begins at a byte, as its checksum says they were written."""
    try:
        data = Messages(path).content(place)
    except (OSError, _Damage) as error:
        raise UnusableFile(path, f"has no sound chunk at byte {place}") from error
    found: list[Placed] = []
    at = 0
    while at + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if opcode == MESSAGE and length >= _MESSAGE.size:
            number, _, time, _ = _MESSAGE.unpack_from(data, at)
            found.append(Placed(number, time, data[at + _MESSAGE.size : at + length]))
        at += length
    return found


def _exactly(file: BinaryIO, length: int) -> bytes:
    data = file.read(length)
    if len(data) != length:
        raise _Damage
    return data


def _number(record: bytes) -> int:
    return struct.unpack_from("<H", record)[0]


def _bytes(record: bytes, place: int, kind: str) -> tuple[bytes, int]:
    """Bytes after their length, and where they end."""
    start = place + struct.calcsize(kind)
    if start > len(record):
        raise _Damage
    (length,) = struct.unpack_from(kind, record, place)
    if length > len(record) - start:
        raise _Damage
    return record[start : start + length], start + length


def _text(record: bytes, place: int) -> tuple[str, int]:
    data, end = _bytes(record, place, "<I")
    try:
        return data.decode(), end
    except UnicodeDecodeError as error:
        raise _Damage from error


def _decompressed(packed: bytes, size: int) -> bytes:
    """What was packed, unless it claims another size: zstd would make room for any size that it
    claims."""
    try:
        claimed = zstandard.frame_content_size(packed)
        if claimed not in (size, -1):
            raise _Damage
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise _Damage from error


def _summary(file: BinaryIO, size: int) -> FileSummary | None:
    """What the end of a file says of the whole, if the file has an end and its checksum holds."""
    end = size - _FOOTER.size - len(MAGIC)
    if end < len(MAGIC):
        return None
    file.seek(end)
    footer, magic = file.read(_FOOTER.size), file.read(len(MAGIC))
    if magic != MAGIC or len(footer) != _FOOTER.size:
        return None
    opcode, length, start, _, checksum = _FOOTER.unpack(footer)
    if opcode != FOOTER or length != _FOOTER.size - _RECORD.size or not len(MAGIC) <= start <= end:
        return None
    try:
        summary, seen = _statistics(file, start, end)
    except _Damage:
        return None
    return summary if zlib.crc32(footer[:-4], seen) == checksum else None


def _statistics(file: BinaryIO, start: int, end: int) -> tuple[FileSummary | None, int]:
    """The statistics among the records from start to end, and the checksum of them all."""
    file.seek(start)
    summary, seen, place = None, 0, start
    while place < end:
        head = _exactly(file, _RECORD.size)
        opcode, length = _RECORD.unpack(head)
        if length > min(end - place - _RECORD.size, LARGEST):
            raise _Damage
        body = _exactly(file, length)
        seen = zlib.crc32(body, zlib.crc32(head, seen))
        if opcode == STATISTICS:
            summary = _counted(body)
        place += _RECORD.size + length
    return summary, seen


def _counted(body: bytes) -> FileSummary:
    if len(body) < _STATISTICS.size:
        raise _Damage
    *_, last, length = _STATISTICS.unpack_from(body)
    entries = body[_STATISTICS.size :]
    if len(entries) != length or length % 10:
        raise _Damage
    return FileSummary(dict(struct.iter_unpack("<HQ", entries)), last)
