"""The driver against bytes typed from public sources, and against bytes that make no sense.

TMT  tmtsoftware/galil-prototype, GalilIoTest.scala
EP   motorapp/Galil, GalilConnector.cpp and GalilController.cpp
BL   ESRF BLISS, galil.py
CR   Galil's command reference
"""

import random
import socket
from contextlib import closing

import pytest
from galil_measures import ASKED, Typed, fuzzed, garbled
from hypothesis import given
from hypothesis import strategies as st

from hardware.test_galil_record import typed
from rcmservo.errors import RcmServoError
from rcmservo.hardware.galil.wire import Conversation, Lost, Rejected, TcpStream


def talk_of(*packets: bytes) -> tuple[Conversation, Typed]:
    stream = Typed(*packets)
    return Conversation(stream, 0.25, stream.now), stream


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


@pytest.mark.parametrize(("source", "asked", "packets", "told"), ANSWERS)
def test_answers_are_told_apart_by_their_prompts(
    source: str, asked: list[str], packets: list[bytes], told: list[str]
) -> None:
    talk, stream = talk_of(*packets)
    assert talk.ask(*asked) == told, source
    assert stream.sent == ";".join(asked).encode() + b"\r"


def test_a_refused_command_is_told_with_the_controllers_reason() -> None:
    """TMT b":?" for a=1;BADCMD; CR and BL: TC1 answers "1 Unrecognized command"."""
    talk, stream = talk_of(b":?", b"1 Unrecognized command\r\n:")
    with pytest.raises(Rejected, match="refused 'BADCMD': 1 Unrecognized command"):
        talk.ask("a=1", "BADCMD")
    assert stream.sent == b"a=1;BADCMD\rTC1\r"


def test_a_record_comes_behind_the_prompts_of_its_line_even_in_pieces() -> None:
    """EP: over TCP the record is followed by a colon, 227 bytes in all for four axes."""
    whole = b"::" + typed() + b":"
    for cut in (1, 2, 3, 100, len(whole) - 1):
        talk, _ = talk_of(whole[:cut], whole[cut:])
        assert talk.record(4, "JG 0", "hb=1").axes[1]["position"] == -1008
    talk, _ = talk_of(b":?" + typed() + b":", b"6 Number out of range\r\n:")
    with pytest.raises(Rejected, match="refused 'hb=1': 6"):
        talk.record(4, "JG 0", "hb=1")


@pytest.mark.parametrize("packets", [(b"::",), (b":x",), (b" 1.0000\r\n: 2.0000\r\n:",)])
def test_more_than_was_asked_for_ends_the_conversation(packets: tuple[bytes, ...]) -> None:
    """Or the next answer would be taken for this one's."""
    talk, _ = talk_of(*packets)
    with pytest.raises(Lost, match="more than"):
        talk.ask("MG 1")


@pytest.mark.parametrize("packets", [(), (b" 1.0",), (b"1\r\n",), (b"x" * (1 << 21),)])
def test_less_ends_it_after_its_patience(packets: tuple[bytes, ...]) -> None:
    talk, stream = talk_of(*packets)
    with pytest.raises(Lost):
        talk.ask("MG 1")
    assert stream.time <= 0.26


def test_a_program_is_downloaded_line_by_line_and_answered_twice_at_its_end() -> None:
    """EP programDownload and TMT: nothing but "::" behind the backslash."""
    talk, stream = talk_of(b"::")
    talk.download(["#A", "EN"])
    assert stream.sent == b"DL\r#A\rEN\r\\\r"


def test_a_program_line_that_is_refused_is_told() -> None:
    """TMT: b"?" before the backslash."""
    talk, _ = talk_of(b"?", b":", b"60 Download error\r\n:")
    with pytest.raises(RcmServoError):
        talk.download(["#A", "EN"])


PIECES = st.one_of(
    st.binary(max_size=300),
    st.sampled_from([b":", b"?", b" 1.0000\r\n:", b" -1.0000\r\n:", b" 4, 52, 26, 36\r\n:",
                     typed() + b":", b"nan\r\n:", b" inf\r\n:", b"::::", b"\x1a:"]),
)  # fmt: skip


@pytest.mark.parametrize("asked", ASKED)
@given(packets=st.lists(PIECES, max_size=40))
def test_whatever_it_answers_it_ends_in_time_in_a_sentence(
    asked: str, packets: list[bytes]
) -> None:
    stream = fuzzed(packets, asked)
    assert stream.time < 40 * 0.26 + 0.6


@given(packets=st.lists(PIECES, max_size=40))
def test_whatever_it_answers_the_driver_itself_never_begins_an_axis(packets: list[bytes]) -> None:
    """The watchdog program does."""
    assert b"BG" not in fuzzed(packets, "start").sent.replace(b"_BG", b"")


@given(seed=st.integers(0, 1 << 30))
def test_on_a_wire_that_garbles_answers_no_step_hangs_and_nothing_goes_on_moving(seed: int) -> None:
    longest, _, off = garbled(random.Random(seed))
    assert longest < 2.0
    assert off


def test_such_a_wire_is_often_good_enough_to_begin() -> None:
    """Or nothing would be tried."""
    assert sum(garbled(random.Random(seed))[1] for seed in range(40)) > 10


def test_what_comes_unasked_is_read_line_by_line_without_its_mark() -> None:
    marked = bytes(byte | 0x80 for byte in b"POSERR ON A\r\n\r\nhalf a li")
    stream = Unasked(marked[:5], marked[5:], b"", b"ne\r\n", bytes(range(200)) * 50)
    talk = Conversation(stream, 0.25)
    assert talk.overheard() == []
    assert talk.overheard() == ["POSERR ON A"]
    assert talk.overheard() == []
    assert talk.overheard() == ["half a line"]
    talk.overheard()
    assert len(talk._heard) <= 80 and stream.waited == 0.0


class Unasked:
    """A stream that says things, one after the other."""

    def __init__(self, *packets: bytes) -> None:
        self.packets, self.waited = list(packets), 0.0

    def send(self, data: bytes) -> None:
        raise AssertionError

    def receive(self, seconds: float) -> bytes:
        self.waited += seconds
        return self.packets.pop(0)

    def close(self) -> None:
        pass


def test_looking_whether_something_has_come_does_not_wait_and_sending_has_its_own_time() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        stream = TcpStream("127.0.0.1", server.getsockname()[1], 0.25)
        with closing(stream), closing(server.accept()[0]):
            assert stream.receive(0.0) == b""
            assert stream._wire.gettimeout() == 0.0
            stream.send(b"x")
            assert stream._wire.gettimeout() == 0.25
