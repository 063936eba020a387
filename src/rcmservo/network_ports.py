"""Sentences on a port of this computer that cannot be listened on."""

import errno
import os
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path

SOCKET_TABLES = "tcp", "tcp6", "udp", "udp6"
"""Linux's tables of sockets, in /proc/net."""
LISTENING_STATES = "0A", "07"
"""State of a TCP socket that listens, and of a UDP socket."""
MAX_COMMAND_CHARACTERS = 100
"""Characters of another process's command in a message."""


def refusal(port: int, error: OSError) -> str:
    """Return why a port cannot be listened on, and which process holds it if that is known."""
    why = f"port {port}: cannot be listened on: {error.strerror}"
    holder = _describe_holder(port) if error.errno == errno.EADDRINUSE else ""
    return f"{why} by {holder}" if holder else why


def _describe_holder(port: int) -> str:
    """Return number and command of the process that listens on a port; empty if it is not known,
    as other users' processes are not.
    """
    with suppress(OSError):
        links = {f"socket:[{inode}]" for inode in _listening_inodes(port)}
        for process in filter(str.isdecimal, os.listdir("/proc")):
            with suppress(OSError):
                folder = Path("/proc", process)
                if any(os.readlink(one) in links for one in (folder / "fd").iterdir()):
                    command = (folder / "cmdline").read_bytes().replace(b"\0", b" ")
                    text = command.decode(errors="replace").strip()
                    return f"process {process} ({text[:MAX_COMMAND_CHARACTERS]})"
    return ""


def _listening_inodes(port: int) -> Generator[str]:
    """Yield the inodes of the sockets that listen on a port."""
    for table in SOCKET_TABLES:
        for line in Path("/proc/net", table).read_text().splitlines()[1:]:
            columns = line.split()
            is_port = int(columns[1].rpartition(":")[2], 16) == port
            if is_port and columns[3] in LISTENING_STATES:
                yield columns[9]
