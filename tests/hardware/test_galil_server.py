"""The emulated controller on the network, in time that the test lets pass."""

import socket
from collections.abc import Iterator
from contextlib import closing

import pytest
from galil_measures import IdealMotors

from rcmservo.errors import BadInput
from rcmservo.hardware.galil.emulator.controller import Controller
from rcmservo.hardware.galil.emulator.faults import KINDS, Fault
from rcmservo.hardware.galil.emulator.server import LATE, NoPort, Server


class Lab:
    """A server, hosts and a time."""

    def __init__(self, *faults: str) -> None:
        self.server = Server(Controller(IdealMotors()), 0, [Fault.parse(one) for one in faults])
        self.now = 0.0
        self.wires: list[socket.socket] = []

    def host(self) -> socket.socket:
        wire = socket.create_connection(("127.0.0.1", self.server.port), timeout=5.0)
        self.wires.append(wire)
        self.turn()
        wire.settimeout(0.05)
        return wire

    def turn(self, seconds: float = 0.0) -> None:
        self.now += seconds
        self.server.wait(0.01)
        self.server.turn(self.now)

    def ask(self, wire: socket.socket, text: bytes) -> bytes:
        wire.sendall(text)
        self.turn()
        return heard(wire)

    def close(self) -> None:
        for wire in self.wires:
            wire.close()
        self.server.close()


def heard(wire: socket.socket) -> bytes:
    try:
        return wire.recv(4096)
    except TimeoutError:
        return b""


@pytest.fixture
def lab() -> Iterator[Lab]:
    with closing(Lab()) as lab:
        yield lab


def test_the_answers_to_one_line_come_in_one_packet(lab: Lab) -> None:
    """What public clients rely on: they read once (socs 0.6.4)."""
    assert lab.ask(lab.host(), b"JG 5000;BG A;MG _BGA;TP\r") == (b":: 1.0000\r\n: 0, 0, 0, 0\r\n:")


def test_time_passes_for_the_axes_as_it_does_for_the_server(lab: Lab) -> None:
    wire = lab.host()
    lab.ask(wire, b"AC 1073740800;JG 10240;BG A\r")
    for _ in range(100):
        lab.turn(0.01)
    where = float(lab.ask(wire, b"TP A\r").split(b"\r")[0])
    assert where == pytest.approx(10240, rel=0.02)


def test_a_ninth_host_is_reset_and_the_handle_of_one_that_left_is_free_again(lab: Lab) -> None:
    hosts = [lab.host() for _ in range(8)]
    assert [lab.ask(host, b"WH\r") for host in hosts] == [
        f"IH{letter}\r\n:".encode() for letter in "ABCDEFGH"
    ]
    ninth = lab.host()
    with pytest.raises(ConnectionResetError):
        ninth.recv(1)
    hosts[3].close()
    lab.turn()
    assert lab.ask(lab.host(), b"WH\r") == b"IHD\r\n:"


def test_records_come_by_UDP_as_often_as_DR_says(lab: Lab) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", lab.server.port))
        wire.settimeout(1.0)
        assert lab.ask(wire, b"WH\r") == b"IHA\r\n:"
        assert lab.ask(wire, b"DR 8,0\r") == b":"
        lab.turn(0.01)
        first = int.from_bytes(wire.recv(1000)[4:6], "little")
        lab.turn(0.008)
        assert int.from_bytes(wire.recv(1000)[4:6], "little") == first + 8
    tcp = lab.host()
    assert lab.ask(tcp, b"DR 8,1\r") == b"?"


def test_a_reset_drops_everybody(lab: Lab) -> None:
    wire = lab.host()
    wire.sendall(b"RS\r")
    lab.turn()
    assert wire.recv(10) == b""
    assert lab.ask(lab.host(), b"TP A\r") == b" 0\r\n:"


def test_each_fault_does_what_it_says_and_only_then() -> None:
    for kind in KINDS:
        with closing(Lab(f"{kind}:at=1,for=1")) as lab:
            wire = lab.host()
            assert lab.ask(wire, b"AC 1073740800;JG 2048;BG A;TP A\r") == b"::: 0\r\n:"
            for _ in range(20):
                lab.turn(0.05)
            lab.turn(0.05)
            told = lab.ask(wire, b"MG 1\r") if kind != "reset" else wire.recv(10)
            lab.turn(LATE)
            late = heard(wire)
            expected = {
                "silence": (b"", b""),
                "half": (b" 1.00", b""),
                "slow": (b"", b" 1.0000\r\n:"),
                "reset": (b"", b""),
                "stuck": (b" 1.0000\r\n:", b""),
                "amplifier": (b" 1.0000\r\n:", b""),
            }
            if kind == "garbage":
                assert told and told != b" 1.0000\r\n:"
            else:
                assert (told, late) == expected[kind]
            if kind == "stuck":
                before = lab.ask(wire, b"TP A\r")
                lab.turn(0.1)
                assert lab.ask(wire, b"TP A\r") == before
            if kind == "amplifier":
                asked = b"MG _MOA,_SCA,_TA0;SH A;MG _MOA\r"
                told = lab.ask(wire, asked)
                assert told == b" 1.0000 15.0000 136.0000\r\n:: 0.0000\r\n:"
            lab.turn(1.0)
            heard(wire)
            again = lab.host() if kind == "reset" else wire
            assert lab.ask(again, b"MG 2\r") == b" 2.0000\r\n:"


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
def test_a_fault_that_cannot_be_is_refused(text: str, field: str) -> None:
    with pytest.raises(BadInput) as refused:
        Fault.parse(text)
    assert field in refused.value.field


def test_a_port_in_use_is_told_in_a_sentence(lab: Lab) -> None:
    with pytest.raises(NoPort, match="cannot be listened on"):
        Server(Controller(IdealMotors()), lab.server.port)
