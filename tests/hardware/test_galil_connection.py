"""Connection to a controller against replies from public sources, and against senseless bytes.

TMT  tmtsoftware/galil-prototype, GalilIoTest.scala
EP   motorapp/Galil, GalilConnector.cpp and GalilController.cpp
BL   ESRF BLISS, galil.py
CR   Galil's command reference
"""

import random
import socket
from contextlib import closing

import pytest
from galil_measures import SESSION_STEPS, ScriptedStream, run_with_garbling, run_with_packets
from hypothesis import given
from hypothesis import strategies as st

from hardware.test_galil_record import reference_record
from rcmservo.errors import RcmServoError
from rcmservo.hardware.galil.connection import (
    CommandRejected,
    ConnectionLost,
    GalilConnection,
    TcpStream,
)


def connect(*packets: bytes) -> tuple[GalilConnection, ScriptedStream]:
    stream = ScriptedStream(*packets)
    return GalilConnection(stream, 0.25, stream.now), stream


ANSWERS: list[tuple[str, list[str], list[bytes], list[str]]] = [
    ("TMT", ["MG TIME"], [b"12345\r\n:"], ["12345"]),
    ("TMT", ["speed[0]=500"], [b":"], [""]),
    ("TMT", ["a=1", "b=2", "c=3"], [b":::"], ["", "", ""]),
    (
        "TMT: in two reads",
        ["speed[0]=500", "MG speed[0]"],
        [b":", b"500.0000\r\n:"],
        ["", "500.0000"],
    ),
    ("TMT: in three packets", ["LV"], [b"PART1", b"PART2", b"FINAL\r\n:"], ["PART1PART2FINAL"]),
    ("CR", ["QZ"], [b" 4, 52, 26, 36\r\n:"], ["4, 52, 26, 36"]),
    ("BL", ["\x12\x16"], [b"DMC4010 Rev 1.3c-SER\r\n:"], ["DMC4010 Rev 1.3c-SER"]),
]


@pytest.mark.parametrize(("source", "commands", "packets", "replies"), ANSWERS)
def test_prompts_separate_the_replies(
    source: str, commands: list[str], packets: list[bytes], replies: list[str]
) -> None:
    connection, stream = connect(*packets)
    assert connection.execute(*commands) == replies, source
    assert stream.sent == ";".join(commands).encode() + b"\r"


def test_a_refused_command_raises_the_controllers_reason() -> None:
    """TMT b":?" for a=1;BADCMD; CR and BL: TC1 answers "1 Unrecognized command"."""
    connection, stream = connect(b":?", b"1 Unrecognized command\r\n:")
    with pytest.raises(CommandRejected, match="refused 'BADCMD': 1 Unrecognized command"):
        connection.execute("a=1", "BADCMD")
    assert stream.sent == b"a=1;BADCMD\rTC1\r"


def test_a_record_follows_the_prompts_of_its_line_even_in_pieces() -> None:
    """EP: over TCP the record is followed by a colon, 227 bytes in all for four axes."""
    reply = b"::" + reference_record() + b":"
    for cut in (1, 2, 3, 100, len(reply) - 1):
        connection, _ = connect(reply[:cut], reply[cut:])
        assert connection.read_data_record(4, "JG 0", "hb=1").axes[1]["position"] == -1008
    connection, _ = connect(b":?" + reference_record() + b":", b"6 Number out of range\r\n:")
    with pytest.raises(CommandRejected, match="refused 'hb=1': 6"):
        connection.read_data_record(4, "JG 0", "hb=1")


@pytest.mark.parametrize("packets", [(b"::",), (b":x",), (b" 1.0000\r\n: 2.0000\r\n:",)])
def test_a_surplus_reply_closes_the_connection(packets: tuple[bytes, ...]) -> None:
    """Otherwise the next command would get the reply to another one."""
    connection, _ = connect(*packets)
    with pytest.raises(ConnectionLost, match="more than"):
        connection.execute("MG 1")


@pytest.mark.parametrize("packets", [(), (b" 1.0",), (b"1\r\n",), (b"x" * (1 << 21),)])
def test_a_missing_reply_closes_the_connection_after_the_time_limit(
    packets: tuple[bytes, ...],
) -> None:
    connection, stream = connect(*packets)
    with pytest.raises(ConnectionLost):
        connection.execute("MG 1")
    assert stream.time <= 0.26


def test_a_download_is_sent_line_by_line_and_has_two_prompts_at_its_end() -> None:
    """EP programDownload and TMT: only "::" after the backslash."""
    connection, stream = connect(b"::")
    connection.download_program(["#A", "EN"])
    assert stream.sent == b"DL\r#A\rEN\r\\\r"


def test_a_refused_program_line_raises_an_error() -> None:
    """TMT: b"?" before the backslash."""
    connection, _ = connect(b"?", b":", b"60 Download error\r\n:")
    with pytest.raises(RcmServoError):
        connection.download_program(["#A", "EN"])


PIECES = st.one_of(
    st.binary(max_size=300),
    st.sampled_from([b":", b"?", b" 1.0000\r\n:", b" -1.0000\r\n:", b" 4, 52, 26, 36\r\n:",
                     reference_record() + b":", b"nan\r\n:", b" inf\r\n:", b"::::", b"\x1a:"]),
)  # fmt: skip


@pytest.mark.parametrize("step", SESSION_STEPS)
@given(packets=st.lists(PIECES, max_size=40))
def test_every_step_ends_in_time_with_any_replies(step: str, packets: list[bytes]) -> None:
    stream = run_with_packets(packets, step)
    assert stream.time < 40 * 0.26 + 0.6


@given(packets=st.lists(PIECES, max_size=40))
def test_the_driver_itself_never_begins_a_motion(packets: list[bytes]) -> None:
    """Only the watchdog program begins motions."""
    assert b"BG" not in run_with_packets(packets, "start").sent.replace(b"_BG", b"")


@given(seed=st.integers(0, 1 << 30))
def test_with_garbled_replies_no_step_hangs_and_nothing_keeps_moving(seed: int) -> None:
    longest_step_s, _, motors_off = run_with_garbling(random.Random(seed))
    assert longest_step_s < 2.0
    assert motors_off


def test_garbled_replies_often_permit_a_start() -> None:
    """Otherwise the test above would test nothing."""
    assert sum(run_with_garbling(random.Random(seed))[1] for seed in range(40)) > 10


def test_unsolicited_messages_are_read_line_by_line_without_the_high_bit() -> None:
    marked = bytes(byte | 0x80 for byte in b"POSERR ON A\r\n\r\nhalf a li")
    stream = ScriptedMessages(marked[:5], marked[5:], b"", b"ne\r\n", bytes(range(200)) * 50)
    connection = GalilConnection(stream, 0.25)
    assert connection.read_messages() == []
    assert connection.read_messages() == ["POSERR ON A"]
    assert connection.read_messages() == []
    assert connection.read_messages() == ["half a line"]
    connection.read_messages()
    assert len(connection._received) <= 80 and stream.waited == 0.0


class ScriptedMessages:
    """Stream that receives some packets in turn."""

    def __init__(self, *packets: bytes) -> None:
        self.packets, self.waited = list(packets), 0.0

    def send(self, data: bytes) -> None:
        raise AssertionError

    def receive(self, seconds: float) -> bytes:
        self.waited += seconds
        return self.packets.pop(0)

    def close(self) -> None:
        pass


def test_receiving_without_a_wait_does_not_change_the_time_limit_of_sending() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        stream = TcpStream("127.0.0.1", server.getsockname()[1], 0.25)
        with closing(stream), closing(server.accept()[0]):
            assert stream.receive(0.0) == b""
            assert stream._socket.gettimeout() == 0.0
            stream.send(b"x")
            assert stream._socket.gettimeout() == 0.25
