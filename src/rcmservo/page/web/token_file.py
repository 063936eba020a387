"""The token that a browser elsewhere must give: in a file, as a list of processes shows options."""

import os
import stat
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path

from rcmservo.errors import BadInput, UnusableFile, require
from rcmservo.page.web.access import drawn_secret

SHORTEST, LONGEST = 16, 256
"""Characters of a token."""


def token_for(host: str, file: Path | None) -> str:
    """The token of a server that listens there: empty where none is asked for, which is at an
    address that this computer alone reaches.
    """
    try:
        alone = IPv4Address(host).is_loopback
    except AddressValueError as error:
        right = "an IPv4 address of this computer, or 0.0.0.0 for all that it has"
        raise BadInput("--host", host, right) from error
    if file is None:
        right = "an address that this computer alone reaches, as 127.0.0.1, without --token-file"
        require(alone, "--host", host, right)
        return ""
    return token_in(file)


def token_in(file: Path) -> str:
    """What the file holds. Where there is none, it is made with a token that is drawn."""
    try:
        _make(file)
    except FileExistsError:
        """It is read."""
    except OSError as error:
        raise UnusableFile(file, f"cannot be made: {error.strerror}") from error
    return _read(file)


def _make(file: Path) -> None:
    opened = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(opened, "w") as new:
        new.write(drawn_secret() + "\n")


def _read(file: Path) -> str:
    try:
        with os.fdopen(os.open(file, os.O_RDONLY | os.O_NONBLOCK), "rb") as old:
            mode = os.fstat(old.fileno()).st_mode
            if not stat.S_ISREG(mode):
                raise UnusableFile(file, "is no file that could hold a token")
            if mode & 0o077:
                may = f"others than its owner can read it or write to it: chmod 600 {file}"
                raise UnusableFile(file, may)
            text = old.read(LONGEST + 2).strip()
    except OSError as error:
        raise UnusableFile(file, f"cannot be read: {error.strerror}") from error
    if not (SHORTEST <= len(text) <= LONGEST and all(33 <= one <= 126 for one in text)):
        right = f"a token is one word of {SHORTEST} to {LONGEST} ASCII letters, digits or signs"
        raise UnusableFile(file, f"holds no token: {right}")
    return text.decode()
