"""Files that are there whole or not at all."""

from pathlib import Path

from rcmservo.errors import UnusableFile


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text)
        part.replace(path)
    except OSError as error:
        raise UnusableFile(path, f"cannot be written: {error.strerror}") from error
