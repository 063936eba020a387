"""Reader of damaged MCAP files that returns only the messages that are certainly intact.

An MCAP file is a sequence of records, each with a kind (opcode) and a length; a chunk is a record
that contains messages. Only messages inside chunks are returned, because only chunks carry a
checksum. Message numbers rise by one within a topic, so no message can be missing unnoticed. The
recorder writes only known kinds of records between chunks, so an unknown kind is damage. Each
length is compared with the size of the file before it is used, so that any bytes are read in little
memory.

The package `mcap` parses the records. Its `StreamReader` is unsuitable, as
tests/recording/test_damage.py shows: it skips a chunk with a damaged kind, returns messages without
a checksum, unpacks more than a chunk declares, and does not report the byte at which it stopped. It
also takes three times as long per message, so this module unpacks messages itself.
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
"""First and last bytes of a file."""
RECORD_HEAD = struct.Struct("<BQ")
"""Kind (opcode) of a record and length of its body in bytes."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel of a message, its number in the channel, and its times of logging and publishing."""
INDEX_HEAD = struct.Struct("<HI")
"""Channel of a message index and the length of its entries."""
INDEX_ENTRY_BYTES = 16
"""Size of a message's entry in a message index."""
FOOTER_BYTES = RECORD_HEAD.size + 20
"""Size of the record at the end of a file, which locates the file's summary."""
CHECKSUM_BYTES = 4
MAX_RECORD_BYTES = 32 * 2**20
"""Largest size of a record in bytes, compressed or not."""
UNPACKED_ALLOWANCE_BYTES = 64 * 2**20
MAX_COMPRESSION_RATIO = 32
"""The chunks of a file may unpack to `UNPACKED_ALLOWANCE_BYTES` plus `MAX_COMPRESSION_RATIO` times
its size, far more than a run needs."""

Parsed = TypeVar("Parsed")


class _DamageError(McapError):
    """Error of damaged bytes; no byte that follows can be trusted."""


DAMAGE_ERRORS = McapError, ValueError, struct.error, zstandard.ZstdError
"""Errors of parsing damaged bytes."""


class Message(NamedTuple):
    """One message of a file.

    Parameters
    ----------
    topic : str
        Name of its channel, such as rcmservo/tick.
    definition : str
        Definition of its type in the ROS 2 format; empty if the file holds none.
    time : int
        Log time in ns since the start of the record.
    data : bytes
        Bytes of the message in CDR, the byte format of ROS 2.
    """

    topic: str
    definition: str
    time: int
    data: bytes


@dataclass
class _Channel:
    """Topic, with the definition of its messages and the number of messages read so far."""

    topic: str
    definition: str
    count: int = 0


class MessageReader:
    """Iterator over the intact messages of a file, usable once.

    Afterwards ``position`` is the byte up to which the file is intact, ``size`` its length,
    ``complete`` is true if nothing is missing, and ``summary`` holds the statistics of an intact
    end of the file.

    Parameters
    ----------
    path : Path
        MCAP file.

    Raises
    ------
    UnusableFile
        On iteration, if the file cannot be read or is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size, self.position = 0, 0
        self.complete = False
        self.summary: mcap_records.Statistics | None = None
        self._definitions: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}
        self._chunk_counts: Counter[int] = Counter()
        self._unpack_budget = 0

    @property
    def unread(self) -> int:
        """Number of bytes that damage leaves unread."""
        return 0 if self.complete else self.size - self.position

    @property
    def location(self) -> tuple[int, int]:
        """Byte at which the chunk of the last message begins, and the message's index there.

        `read_chunk` takes this position.
        """
        return self.position, self._chunk_counts.total() - 1

    def channel(self, topic: str) -> int:
        """Return the id of a topic's channel, or −1 if none has been read."""
        ids = (number for number, channel in self._channels.items() if channel.topic == topic)
        return next(ids, -1)

    def __iter__(self) -> Iterator[Message]:
        if self.path.exists() and not self.path.is_file():
            raise UnusableFile(self.path, "is not a file")
        try:
            with self.path.open("rb") as file:
                self.size = self.path.stat().st_size
                self._unpack_budget = UNPACKED_ALLOWANCE_BYTES + MAX_COMPRESSION_RATIO * self.size
                if file.read(len(MAGIC)) != MAGIC:
                    reason = "is not a record: it is no MCAP file, or its start is damaged"
                    raise UnusableFile(self.path, reason)
                with suppress(*DAMAGE_ERRORS):
                    self.summary = _read_summary(file, self.size)
                self.position = len(MAGIC)
                with suppress(*DAMAGE_ERRORS):
                    yield from self._read_data_section(file)
        except OSError as error:
            raise UnusableFile(self.path, f"cannot be read: {error.strerror}") from error
        counts = {i: channel.count for i, channel in self._channels.items() if channel.count}
        self.complete = self.summary is not None and counts == self.summary.channel_message_counts

    def _read_data_section(self, file: BinaryIO) -> Iterator[Message]:
        """Yield the messages of all chunks."""
        for opcode, body in _read_records(file, self.position, self.size):
            if self.position == len(MAGIC) and opcode == Opcode.HEADER:
                _parse(mcap_records.Header.read, body)
            elif self.position == len(MAGIC):
                raise _DamageError
            elif opcode == Opcode.CHUNK:
                yield from self._read_chunk_messages(self._unpack(body))
            elif opcode == Opcode.MESSAGE_INDEX:
                self._check_index(body)
            elif opcode != Opcode.DATA_END or len(body) != CHECKSUM_BYTES:
                raise _DamageError
            self.position += RECORD_HEAD.size + len(body)
            if opcode == Opcode.DATA_END:
                return

    def _unpack(self, body: bytes) -> bytes:
        """Return the content of a chunk, within the limit for the whole file."""
        chunk = _parse(mcap_records.Chunk.read, body)
        self._unpack_budget -= chunk.uncompressed_size
        if self._unpack_budget < 0:
            raise _DamageError
        return _unpack(chunk)

    def _check_index(self, body: bytes) -> None:
        """Raise an error unless an index has an entry for each message of the last chunk.

        An index belongs to one channel.
        """
        channel, length = INDEX_HEAD.unpack_from(body)
        expected = self._chunk_counts.pop(channel, 0) * INDEX_ENTRY_BYTES
        if not 0 < length == expected == len(body) - INDEX_HEAD.size:
            raise _DamageError

    def _read_chunk_messages(self, content: bytes) -> Iterator[Message]:
        """Yield the messages of a chunk, and store its schemas and channels."""
        self._chunk_counts.clear()
        for opcode, body in _split_chunk(content):
            if opcode == Opcode.MESSAGE:
                yield self._decode_message(body)
            elif opcode == Opcode.SCHEMA:
                schema = _parse(mcap_records.Schema.read, body)
                self._definitions[schema.id] = schema.data.decode()
            elif opcode == Opcode.CHANNEL:
                channel = _parse(mcap_records.Channel.read, body)
                definition = self._definitions.get(channel.schema_id, "")
                self._channels.setdefault(channel.id, _Channel(channel.topic, definition))
            else:
                raise _DamageError

    def _decode_message(self, body: bytes) -> Message:
        """Return a message if it is the next one of its channel."""
        channel_id, number, time, _ = MESSAGE_HEAD.unpack_from(body)
        channel = self._channels.get(channel_id)
        if channel is None or number != channel.count:
            raise _DamageError
        channel.count += 1
        self._chunk_counts[channel_id] += 1
        return Message(channel.topic, channel.definition, time, body[MESSAGE_HEAD.size :])


def find_chunks(path: Path) -> list[int]:
    """Return the bytes at which the chunks of a file begin.

    The search reads the record heads only and ends at the end of the file or at damage.
    """
    positions: list[int] = []
    try:
        with path.open("rb", buffering=0) as file, suppress(*DAMAGE_ERRORS):
            size, position = path.stat().st_size, len(MAGIC)
            while size - position >= RECORD_HEAD.size:
                opcode, length = _read_head(file, position, size)
                if opcode not in (Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX):
                    break
                if opcode == Opcode.CHUNK:
                    positions.append(position)
                position += RECORD_HEAD.size + length
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error}") from error
    return positions


def read_chunk(path: Path, position: int) -> list[mcap_records.Message]:
    """Return the messages of the chunk at a byte, verified by its checksum.

    Raises
    ------
    UnusableFile
        If no intact chunk begins there.
    """
    try:
        with path.open("rb") as file:
            opcode, body = next(_read_records(file, position, path.stat().st_size), (0, b""))
        if opcode != Opcode.CHUNK:
            raise _DamageError
        content = _unpack(_parse(mcap_records.Chunk.read, body))
        return [
            mcap_records.Message.read(ReadDataStream(BytesIO(message)), len(message))
            for kind, message in _split_chunk(content)
            if kind == Opcode.MESSAGE
        ]
    except (OSError, *DAMAGE_ERRORS) as error:
        raise UnusableFile(path, f"has no intact chunk at byte {position}") from error


def _read_head(file: BinaryIO, position: int, end: int) -> tuple[int, int]:
    """Return kind and length of the record at a byte; it must end before `end`."""
    file.seek(position)
    opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
    if length > min(end - position - RECORD_HEAD.size, MAX_RECORD_BYTES):
        raise _DamageError
    return opcode, length


def _read_records(file: BinaryIO, position: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each record from a byte on."""
    while end - position >= RECORD_HEAD.size:
        opcode, length = _read_head(file, position, end)
        body = file.read(length)
        if len(body) != length:
            raise _DamageError
        yield opcode, body
        position += RECORD_HEAD.size + length


def _split_chunk(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each record in the content of a chunk."""
    position, end = 0, len(content)
    while position < end:
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        position += RECORD_HEAD.size
        if length > end - position:
            raise _DamageError
        yield opcode, content[position : position + length]
        position += length


def _parse(read: Callable[[ReadDataStream], Parsed], body: bytes) -> Parsed:
    """Return the record that `read` finds in a body; raise an error if more bytes follow."""
    stream = ReadDataStream(BytesIO(body))
    record = read(stream)
    if stream.count != len(body):
        raise _DamageError
    return record


def _unpack(chunk: mcap_records.Chunk) -> bytes:
    """Return the content of a chunk, verified by its checksum.

    Only the size that the chunk declares is allocated: the decompressor alone would allocate any
    size that the compressed data declare.
    """
    size, data = chunk.uncompressed_size, chunk.data
    if size > MAX_RECORD_BYTES or chunk.compression not in ("", "zstd"):
        raise _DamageError
    if chunk.compression:
        if zstandard.frame_content_size(data) not in (size, -1):
            raise _DamageError
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if len(data) != size or zlib.crc32(data) != chunk.uncompressed_crc:
        raise _DamageError
    return data


def _read_summary(file: BinaryIO, size: int) -> mcap_records.Statistics | None:
    """Return the statistics in the summary of a file; None unless its checksum is right."""
    footer_start = size - FOOTER_BYTES - len(MAGIC)
    file.seek(max(footer_start, 0))
    ending = file.read()
    footer = _parse(mcap_records.Footer.read, ending[RECORD_HEAD.size : -len(MAGIC)])
    head = RECORD_HEAD.pack(Opcode.FOOTER, FOOTER_BYTES - RECORD_HEAD.size)
    is_intact = ending.endswith(MAGIC) and ending.startswith(head)
    if not is_intact or not len(MAGIC) <= footer.summary_start <= footer_start:
        return None
    statistics, checksum = None, 0
    for opcode, body in _read_records(file, footer.summary_start, footer_start):
        checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, len(body)), checksum))
        if opcode == Opcode.STATISTICS:
            statistics = _parse(mcap_records.Statistics.read, body)
    checksum = zlib.crc32(ending[: FOOTER_BYTES - CHECKSUM_BYTES], checksum)
    return statistics if checksum == footer.summary_crc else None
