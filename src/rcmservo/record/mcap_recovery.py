"""Messages of an MCAP file that are certainly as they were written, up to its end or first damage.

Only what lies in a chunk counts, because only that carries a checksum. Every message has a number
that rises by one from message to message of its topic, so that none can be missing unnoticed.
Between the chunks stands only what the recorder writes there: a chunk whose kind is damaged is
damage, not something to pass over. No length in the file is believed before it is compared with
what is there, so that reading takes little memory, whatever the bytes.

`mcap` parses the records, but its `StreamReader` cannot walk through the file, as two tests of it
in tests/record/test_damage.py show: it passes over a chunk whose kind is damaged, returns messages
that no checksum covers, unpacks more than a chunk claims to hold, and does not report at which byte
it stopped. It also takes three times as long for a message, so messages alone are unpacked here.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeVar

import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from rcmservo.errors import UnusableFile

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Kind (opcode) and length of a record."""
MESSAGE = struct.Struct("<HIQQ")
"""Channel of a message, its number there, and its times of logging and publishing."""
INDEX = struct.Struct("<HI")
"""Channel of a message index, and the length of its entries."""
INDEX_ENTRY = 16
FOOTER = HEAD.size + 20
CHECKSUM = 4
MAX_RECORD = 32 * 2**20
"""Bytes of the largest record, packed or unpacked."""
FREE_UNPACKED = 64 * 2**20
MAX_RATIO = 32
"""A file may unpack to FREE_UNPACKED bytes and MAX_RATIO times its size: far more than a run's
numbers ever do."""

Parsed = TypeVar("Parsed")


class _Damage(McapError):
    """Bytes from which on nothing can be trusted."""


DAMAGE = McapError, ValueError, struct.error, zstandard.ZstdError
"""Errors of parsing damaged bytes."""


class Message(NamedTuple):
    """A message as it was written."""

    topic: str
    """Its channel's name, such as rcmservo/tick."""
    definition: str
    """Layout of its topic's messages, as ROS 2 writes it; empty where the file has none."""
    time: int
    """When it was logged, ns since the record's start."""
    data: bytes
    """Its bytes, in CDR."""


@dataclass
class _Channel:
    """A topic, and how far it has been read."""

    topic: str
    definition: str
    read: int = 0


class MessageReader:
    """Reads a file once, by iteration; then ``place``, ``complete`` and ``summary`` report how far
    it could be read.

    ``place`` is the byte up to which the file is sound, of ``size``; ``complete`` means that
    nothing is missing. ``summary`` is what a sound end of the file states about the whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size, self.place = 0, 0
        self.complete = False
        self.summary: mcap_records.Statistics | None = None
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}
        self._chunk: Counter[int] = Counter()
        self._unpackable = 0

    @property
    def unread(self) -> int:
        """Bytes of the file that are not read because of damage."""
        return 0 if self.complete else self.size - self.place

    @property
    def where(self) -> tuple[int, int]:
        """Byte at which the chunk of the message read last begins, and its index there; see
        `read_chunk`."""
        return self.place, self._chunk.total() - 1

    def channel(self, topic: str) -> int:
        """Return the id of a topic's channel, −1 where none was read so far."""
        return next((n for n, one in self._channels.items() if one.topic == topic), -1)

    def __iter__(self) -> Iterator[Message]:
        if self.path.exists() and not self.path.is_file():
            raise UnusableFile(self.path, "is not a file")
        try:
            with self.path.open("rb") as file:
                self.size = self.path.stat().st_size
                self._unpackable = FREE_UNPACKED + MAX_RATIO * self.size
                if file.read(len(MAGIC)) != MAGIC:
                    raise UnusableFile(
                        self.path, "is not a record: it is no MCAP file, or its start is damaged"
                    )
                with suppress(*DAMAGE):
                    self.summary = _summary(file, self.size)
                self.place = len(MAGIC)
                with suppress(*DAMAGE):
                    yield from self._data_section(file)
        except OSError as error:
            raise UnusableFile(self.path, f"cannot be read: {error.strerror}") from error
        read = {number: channel.read for number, channel in self._channels.items() if channel.read}
        self.complete = self.summary is not None and read == self.summary.channel_message_counts

    def _data_section(self, file: BinaryIO) -> Iterator[Message]:
        """Yield the messages of chunk after chunk."""
        for opcode, body in _records(file, self.place, self.size):
            if self.place == len(MAGIC) and opcode == Opcode.HEADER:
                _parse(mcap_records.Header.read, body)
            elif self.place == len(MAGIC):
                raise _Damage
            elif opcode == Opcode.CHUNK:
                yield from self._messages(self._unpack(body))
            elif opcode == Opcode.MESSAGE_INDEX:
                self._check_index(body)
            elif opcode != Opcode.DATA_END or len(body) != CHECKSUM:
                raise _Damage
            self.place += HEAD.size + len(body)
            if opcode == Opcode.DATA_END:
                return

    def _unpack(self, body: bytes) -> bytes:
        """Return a chunk's content, unless the file unpacks to too much in all."""
        chunk = _parse(mcap_records.Chunk.read, body)
        self._unpackable -= chunk.uncompressed_size
        if self._unpackable < 0:
            raise _Damage
        return _unpack(chunk)

    def _check_index(self, body: bytes) -> None:
        """An index must have an entry for every message of its channel in the chunk before it."""
        channel, length = INDEX.unpack_from(body)
        expected = self._chunk.pop(channel, 0) * INDEX_ENTRY
        if not 0 < length == expected == len(body) - INDEX.size:
            raise _Damage

    def _messages(self, content: bytes) -> Iterator[Message]:
        """Yield the messages of a chunk; schemas and channels are noted on the way."""
        self._chunk.clear()
        for opcode, body in _split(content):
            if opcode == Opcode.MESSAGE:
                yield self._message(body)
            elif opcode == Opcode.SCHEMA:
                schema = _parse(mcap_records.Schema.read, body)
                self._schemas[schema.id] = schema.data.decode()
            elif opcode == Opcode.CHANNEL:
                channel = _parse(mcap_records.Channel.read, body)
                definition = self._schemas.get(channel.schema_id, "")
                self._channels.setdefault(channel.id, _Channel(channel.topic, definition))
            else:
                raise _Damage

    def _message(self, body: bytes) -> Message:
        number, sequence, time, _ = MESSAGE.unpack_from(body)
        channel = self._channels.get(number)
        if channel is None or sequence != channel.read:
            raise _Damage
        channel.read += 1
        self._chunk[number] += 1
        return Message(channel.topic, channel.definition, time, body[MESSAGE.size :])


def find_chunks(path: Path) -> list[int]:
    """Return the bytes at which a file's chunks begin, by their heads alone, up to where the file
    ends or is certainly damaged."""
    places: list[int] = []
    try:
        with path.open("rb", buffering=0) as file, suppress(*DAMAGE):
            size, place = path.stat().st_size, len(MAGIC)
            while size - place >= HEAD.size:
                opcode, length = _head(file, place, size)
                if opcode not in (Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX):
                    break
                if opcode == Opcode.CHUNK:
                    places.append(place)
                place += HEAD.size + length
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error}") from error
    return places


def read_chunk(path: Path, place: int) -> list[mcap_records.Message]:
    """Return the messages of the chunk that begins at a byte, as its checksum proves that they were
    written."""
    try:
        with path.open("rb") as file:
            opcode, body = next(_records(file, place, path.stat().st_size), (0, b""))
        if opcode != Opcode.CHUNK:
            raise _Damage
        content = _unpack(_parse(mcap_records.Chunk.read, body))
        return [
            mcap_records.Message.read(ReadDataStream(BytesIO(one)), len(one))
            for kind, one in _split(content)
            if kind == Opcode.MESSAGE
        ]
    except (OSError, *DAMAGE) as error:
        raise UnusableFile(path, f"has no sound chunk at byte {place}") from error


def _head(file: BinaryIO, place: int, end: int) -> tuple[int, int]:
    """Return kind and length of the record at a byte, if it can end before `end`."""
    file.seek(place)
    opcode, length = HEAD.unpack(file.read(HEAD.size))
    if length > min(end - place - HEAD.size, MAX_RECORD):
        raise _Damage
    return opcode, length


def _records(file: BinaryIO, place: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each record from a byte on."""
    while end - place >= HEAD.size:
        opcode, length = _head(file, place, end)
        body = file.read(length)
        if len(body) != length:
            raise _Damage
        yield opcode, body
        place += HEAD.size + length


def _split(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each record in a chunk's content."""
    place, end = 0, len(content)
    while place < end:
        opcode, length = HEAD.unpack_from(content, place)
        place += HEAD.size
        if length > end - place:
            raise _Damage
        yield opcode, content[place : place + length]
        place += length


def _parse(read: Callable[[ReadDataStream], Parsed], body: bytes) -> Parsed:
    """Return the record in a body that holds nothing else."""
    stream = ReadDataStream(BytesIO(body))
    record = read(stream)
    if stream.count != len(body):
        raise _Damage
    return record


def _unpack(chunk: mcap_records.Chunk) -> bytes:
    """Return a chunk's content, as its checksum proves that it was written. Memory is not made for
    another size than the chunk states: zstd would make room for any that its data claim."""
    size, data = chunk.uncompressed_size, chunk.data
    if size > MAX_RECORD or chunk.compression not in ("", "zstd"):
        raise _Damage
    if chunk.compression:
        if zstandard.frame_content_size(data) not in (size, -1):
            raise _Damage
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if len(data) != size or zlib.crc32(data) != chunk.uncompressed_crc:
        raise _Damage
    return data


def _summary(file: BinaryIO, size: int) -> mcap_records.Statistics | None:
    """Return what the end of a file states about the whole, if it has an end whose checksum
    holds."""
    end = size - FOOTER - len(MAGIC)
    file.seek(max(end, 0))
    data = file.read()
    footer = _parse(mcap_records.Footer.read, data[HEAD.size : -len(MAGIC)])
    sound = data.endswith(MAGIC) and data.startswith(HEAD.pack(Opcode.FOOTER, FOOTER - HEAD.size))
    if not sound or not len(MAGIC) <= footer.summary_start <= end:
        return None
    statistics, checksum = None, 0
    for opcode, body in _records(file, footer.summary_start, end):
        checksum = zlib.crc32(body, zlib.crc32(HEAD.pack(opcode, len(body)), checksum))
        if opcode == Opcode.STATISTICS:
            statistics = _parse(mcap_records.Statistics.read, body)
    checksum = zlib.crc32(data[: FOOTER - CHECKSUM], checksum)
    return statistics if checksum == footer.summary_crc else None
