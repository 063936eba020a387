"""Error messages for a port of this computer on which a server cannot listen."""

import errno
import os
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path

SOCKET_TABLES = "tcp", "tcp6", "udp", "udp6"
"""Socket tables of Linux in /proc/net."""

LISTENING_STATES = "0A", "07"
"""State codes of a listening TCP socket and of a UDP socket in these tables."""

MAX_COMMAND_CHARACTERS = 100
"""Largest number of characters of another process's command in a message."""


def describe_refusal(port: int, error: OSError) -> str:
    """Return the error message for a port on which a server cannot listen.

    It names the process that listens on the port already, if that is known.
    """
    message = f"port {port}: cannot listen on it: {error.strerror}"
    process = _describe_listening_process(port) if error.errno == errno.EADDRINUSE else ""
    return f"{message} by {process}" if process else message


def _describe_listening_process(port: int) -> str:
    """Return the number and command of the process that listens on a port; empty if unknown.

    Processes of other users are unknown.
    """
    with suppress(OSError):
        links = {f"socket:[{inode}]" for inode in _find_listening_inodes(port)}
        for process in filter(str.isdecimal, os.listdir("/proc")):
            with suppress(OSError):
                folder = Path("/proc", process)
                if any(os.readlink(file) in links for file in (folder / "fd").iterdir()):
                    command = (folder / "cmdline").read_bytes().replace(b"\0", b" ")
                    text = command.decode(errors="replace").strip()
                    return f"process {process} ({text[:MAX_COMMAND_CHARACTERS]})"
    return ""


def _find_listening_inodes(port: int) -> Generator[str]:
    """Yield the inodes of the sockets that listen on a port."""
    for table in SOCKET_TABLES:
        for line in Path("/proc/net", table).read_text().splitlines()[1:]:
            columns = line.split()
            is_port = int(columns[1].rpartition(":")[2], 16) == port
            if is_port and columns[3] in LISTENING_STATES:
                yield columns[9]
