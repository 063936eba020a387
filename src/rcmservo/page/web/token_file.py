"""Token file of remote browsers.

A remote browser must send the token before it gets the page. The token is not an option of the
command line, because every user of the computer can list the options of running processes.
"""

import os
import re
import stat
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path

from rcmservo.errors import BadInput, UnusableFile, require
from rcmservo.page.web.access import draw_secret

MIN_TOKEN_CHARACTERS, MAX_TOKEN_CHARACTERS = 16, 256
"""Limits of a token's length in characters."""

TOKEN = re.compile(rb"[!-~]{%d,%d}" % (MIN_TOKEN_CHARACTERS, MAX_TOKEN_CHARACTERS))
"""Pattern of a token: visible ASCII characters."""


def load_required_token(host: str, file: Path | None) -> str:
    """Return the token of a server that listens on `host`, or "" if none is required.

    No token is required at an address that only this computer can reach.

    Raises
    ------
    BadInput
        If the address needs a token file, or is not an IPv4 address.
    UnusableFile
        If the file cannot be used.
    """
    try:
        is_loopback = IPv4Address(host).is_loopback
    except AddressValueError as error:
        expected = "an IPv4 address of this computer, or 0.0.0.0 for all its addresses"
        raise BadInput("--host", host, expected) from error
    if file is None:
        expected = "an address that only this computer reaches, as 127.0.0.1, without --token-file"
        require(is_loopback, "--host", host, expected)
        return ""
    return load_token(file)


def load_token(file: Path) -> str:
    """Return the token in a file; create the file with a random token if it does not exist."""
    try:
        new_file = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(new_file, "w") as stream:
            stream.write(draw_secret() + "\n")
    except FileExistsError:
        """The file is read below."""
    except OSError as error:
        raise UnusableFile(file, f"cannot be made: {error.strerror}") from error
    return _read_token(file)


def _read_token(file: Path) -> str:
    try:
        with os.fdopen(os.open(file, os.O_RDONLY | os.O_NONBLOCK), "rb") as stream:
            mode = os.fstat(stream.fileno()).st_mode
            if not stat.S_ISREG(mode):
                raise UnusableFile(file, "is not a regular file")
            if mode & 0o077:
                problem = f"can be read or written by others than its owner: chmod 600 {file}"
                raise UnusableFile(file, problem)
            text = stream.read(MAX_TOKEN_CHARACTERS + 2).strip()
    except OSError as error:
        raise UnusableFile(file, f"cannot be read: {error.strerror}") from error
    if not TOKEN.fullmatch(text):
        characters = (
            f"{MIN_TOKEN_CHARACTERS} to {MAX_TOKEN_CHARACTERS} ASCII letters, digits or signs"
        )
        raise UnusableFile(file, f"holds no token: expected one word of {characters}")
    return text.decode()
