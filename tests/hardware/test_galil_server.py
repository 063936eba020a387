"""Network server of the emulated controller, in simulated time."""

import socket
from collections.abc import Iterator
from contextlib import closing

import pytest
from galil_measures import IdealMotors

from rcmservo.errors import BadInput
from rcmservo.hardware.galil.emulator.controller import GalilController
from rcmservo.hardware.galil.emulator.faults import FAULT_KINDS, Fault
from rcmservo.hardware.galil.emulator.server import SLOW_REPLY_DELAY_S, GalilServer, PortUnavailable


class Lab:
    """Server with its hosts and a clock."""

    def __init__(self, *faults: str) -> None:
        self.server = GalilServer(
            GalilController(IdealMotors()), 0, [Fault.parse(text) for text in faults]
        )
        self.now = 0.0
        self.streams: list[socket.socket] = []

    def host(self) -> socket.socket:
        stream = socket.create_connection(("127.0.0.1", self.server.port), timeout=5.0)
        self.streams.append(stream)
        self.turn()
        stream.settimeout(0.05)
        return stream

    def turn(self, seconds: float = 0.0) -> None:
        self.now += seconds
        self.server.wait(0.01)
        self.server.update(self.now)

    def send(self, stream: socket.socket, text: bytes) -> bytes:
        stream.sendall(text)
        self.turn()
        return receive(stream)

    def close(self) -> None:
        for stream in self.streams:
            stream.close()
        self.server.close()


def receive(stream: socket.socket) -> bytes:
    try:
        return stream.recv(4096)
    except TimeoutError:
        return b""


@pytest.fixture
def lab() -> Iterator[Lab]:
    with closing(Lab()) as lab:
        yield lab


def test_the_answers_to_one_line_come_in_one_packet(lab: Lab) -> None:
    """Public clients rely on it: they read once (socs 0.6.4)."""
    assert lab.send(lab.host(), b"JG 5000;BG A;MG _BGA;TP\r") == (b":: 1.0000\r\n: 0, 0, 0, 0\r\n:")


def test_the_axes_advance_with_the_time_of_the_server(lab: Lab) -> None:
    stream = lab.host()
    lab.send(stream, b"AC 1073740800;JG 10240;BG A\r")
    for _ in range(100):
        lab.turn(0.01)
    position = float(lab.send(stream, b"TP A\r").split(b"\r")[0])
    assert position == pytest.approx(10240, rel=0.02)


def test_a_ninth_host_is_reset_and_a_disconnected_host_frees_its_handle(lab: Lab) -> None:
    hosts = [lab.host() for _ in range(8)]
    assert [lab.send(host, b"WH\r") for host in hosts] == [
        f"IH{letter}\r\n:".encode() for letter in "ABCDEFGH"
    ]
    ninth = lab.host()
    with pytest.raises(ConnectionResetError):
        ninth.recv(1)
    hosts[3].close()
    lab.turn()
    assert lab.send(lab.host(), b"WH\r") == b"IHD\r\n:"


def test_records_come_by_UDP_at_the_period_of_DR(lab: Lab) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        stream.connect(("127.0.0.1", lab.server.port))
        stream.settimeout(1.0)
        assert lab.send(stream, b"WH\r") == b"IHA\r\n:"
        assert lab.send(stream, b"DR 8,0\r") == b":"
        lab.turn(0.01)
        first = int.from_bytes(stream.recv(1000)[4:6], "little")
        lab.turn(0.008)
        assert int.from_bytes(stream.recv(1000)[4:6], "little") == first + 8
    tcp = lab.host()
    assert lab.send(tcp, b"DR 8,1\r") == b"?"


def test_a_reset_drops_all_hosts(lab: Lab) -> None:
    stream = lab.host()
    stream.sendall(b"RS\r")
    lab.turn()
    assert stream.recv(10) == b""
    assert lab.send(lab.host(), b"TP A\r") == b" 0\r\n:"


def test_each_fault_acts_as_described_and_only_in_its_time() -> None:
    for kind in FAULT_KINDS:
        with closing(Lab(f"{kind}:at=1,for=1")) as lab:
            stream = lab.host()
            assert lab.send(stream, b"AC 1073740800;JG 2048;BG A;TP A\r") == b"::: 0\r\n:"
            for _ in range(20):
                lab.turn(0.05)
            lab.turn(0.05)
            reply = lab.send(stream, b"MG 1\r") if kind != "reset" else stream.recv(10)
            lab.turn(SLOW_REPLY_DELAY_S)
            late_reply = receive(stream)
            expected = {
                "silence": (b"", b""),
                "half": (b" 1.00", b""),
                "slow": (b"", b" 1.0000\r\n:"),
                "reset": (b"", b""),
                "stuck": (b" 1.0000\r\n:", b""),
                "amplifier": (b" 1.0000\r\n:", b""),
            }
            if kind == "garbage":
                assert reply and reply != b" 1.0000\r\n:"
            else:
                assert (reply, late_reply) == expected[kind]
            if kind == "stuck":
                position = lab.send(stream, b"TP A\r")
                lab.turn(0.1)
                assert lab.send(stream, b"TP A\r") == position
            if kind == "amplifier":
                query = b"MG _MOA,_SCA,_TA0;SH A;MG _MOA\r"
                assert lab.send(stream, query) == b" 1.0000 15.0000 136.0000\r\n:: 0.0000\r\n:"
            lab.turn(1.0)
            receive(stream)
            present_host = lab.host() if kind == "reset" else stream
            assert lab.send(present_host, b"MG 2\r") == b" 2.0000\r\n:"


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("silense", "--fault"),
        ("slow:at=-1", "at"),
        ("slow:for=0", "for"),
        ("slow:at=soon", "at"),
        ("slow:when=3", "--fault slow"),
        ("slow:at=nan", "at"),
    ],
)
def test_an_invalid_fault_is_refused(text: str, field: str) -> None:
    with pytest.raises(BadInput) as refused:
        Fault.parse(text)
    assert field in refused.value.field


def test_a_port_in_use_is_reported_in_a_sentence(lab: Lab) -> None:
    with pytest.raises(PortUnavailable, match="cannot listen on it"):
        GalilServer(GalilController(IdealMotors()), lab.server.port)
