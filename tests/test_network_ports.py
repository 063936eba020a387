"""Occupied network ports: reported with their process; the page takes the next free pair."""

import os
import socket
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
from galil_measures import IdealMotors
from page_lab import free_port

from conftest import SMALL_RIG_TOML
from rcmservo.cli.cli import main
from rcmservo.hardware.galil.emulator.controller import GalilController
from rcmservo.hardware.galil.emulator.server import GalilServer, PortUnavailable
from rcmservo.page.web import access
from rcmservo.page.web.access import NoPagePort, PortTaken, bind_pair

LOOPBACK = "127.0.0.1"
OCCUPIED_MESSAGE = (
    f"cannot listen on it: Address already in use by process {os.getpid()} \\(.*python"
)


@contextmanager
def occupied(port: int) -> Generator[None]:
    with socket.create_server((LOOPBACK, port)):
        yield


@pytest.fixture
def default(monkeypatch: pytest.MonkeyPatch) -> int:
    """First default port of the page, of six free ones."""
    port = free_port()
    monkeypatch.setattr(access, "DEFAULT_PORT", port)
    monkeypatch.setattr(access, "LAST_DEFAULT_PORT", port + 6)
    return port


def find_port_pair(port: int | None) -> list[int]:
    pair = bind_pair(LOOPBACK, port)
    ports = [one.getsockname()[1] for one in pair]
    for one in pair:
        one.close()
    return ports


@pytest.mark.parametrize("taken", [0, 1])
def test_without_an_option_the_page_takes_the_next_free_pair(default: int, taken: int) -> None:
    assert find_port_pair(None) == [default, default + 1]
    with occupied(default + taken):
        assert find_port_pair(None) == [default + 2, default + 3]


@pytest.mark.parametrize("taken", [0, 1])
def test_a_requested_port_that_is_occupied_is_reported_with_its_process(
    default: int, taken: int
) -> None:
    words = f"port {default + taken}: {OCCUPIED_MESSAGE}.*\\); select another port with --port"
    with occupied(default + taken), pytest.raises(PortTaken, match=words):
        bind_pair(LOOPBACK, default)
    assert find_port_pair(default) == [default, default + 1]


def test_an_address_of_another_computer_is_not_tried_at_other_ports(default: int) -> None:
    with pytest.raises(NoPagePort, match=f"port {default}: cannot listen on it: Cannot assign"):
        bind_pair("192.0.2.1", None)


def test_the_emulated_controller_reports_the_process_on_its_tcp_or_udp_port() -> None:
    port = free_port()
    with occupied(port), pytest.raises(PortUnavailable, match=f"port {port}: {OCCUPIED_MESSAGE}"):
        GalilServer(GalilController(IdealMotors()), port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind((LOOPBACK, port))
        with pytest.raises(PortUnavailable, match=f"port {port}: {OCCUPIED_MESSAGE}"):
            GalilServer(GalilController(IdealMotors()), port)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["emulate galil --mjpeg", "serve --no-browser --port"])
def test_a_command_ends_with_one_sentence_on_an_occupied_port(
    command: str, default: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(SMALL_RIG_TOML)
    out = ["--out", str(tmp_path / "out")] if command.startswith("serve") else ["--port", "0"]
    with occupied(default):
        assert main([*command.split(), str(default), "--rig", str(rig), *out]) == 2
    (message,) = capsys.readouterr().err.splitlines()
    assert message.startswith(f"rcmservo: port {default}: cannot listen on it: ")
    assert f"process {os.getpid()} (" in message
