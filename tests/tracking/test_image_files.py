"""Image files are read completely or refused."""

import os
import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Image
from rcmservo.tracking import read_image


@pytest.fixture
def image() -> Image:
    return np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_a_png_is_read_back_bit_for_bit(tmp_path: Path, image: Image) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), image)
    read = read_image(tmp_path / "0.png")
    assert read.dtype == np.uint8
    np.testing.assert_array_equal(read, image)


def test_a_jpeg_is_read_and_so_is_one_padded_with_zeros(tmp_path: Path, image: Image) -> None:
    data = cv2.imencode(".jpg", image)[1].tobytes()
    for name, content in (("a.jpg", data), ("b.jpg", data + bytes(100))):
        (tmp_path / name).write_bytes(content)
        assert read_image(tmp_path / name).shape == image.shape


@pytest.mark.parametrize("kind", [".jpg", ".png"])
@pytest.mark.parametrize("length_kept", [1, 4, 40, 0.1, 0.5, 0.9, 0.99, -12, -2, -1])
def test_a_truncated_image_is_refused(
    tmp_path: Path, image: Image, kind: str, length_kept: float
) -> None:
    data = cv2.imencode(kind, image)[1].tobytes()
    length = int(length_kept * len(data)) if 0 < length_kept < 1 else int(length_kept)
    path = tmp_path / f"cut{kind}"
    path.write_bytes(data[:length])
    with pytest.raises(UnusableFile, match=re.escape(str(path))):
        read_image(path)


def test_a_png_with_one_changed_byte_is_refused(tmp_path: Path, image: Image) -> None:
    data = bytearray(cv2.imencode(".png", image)[1].tobytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "bad.png").write_bytes(data)
    with pytest.raises(UnusableFile, match="damaged"):
        read_image(tmp_path / "bad.png")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "empty"),
        (b"frame,u,v\n1,2,3\n", "neither"),
        (b"\xff\xd8\xff\xe0 nothing \xff\xd9", "damaged|decoded"),
    ],
)
def test_a_file_that_is_no_image_is_refused_with_the_reason(
    tmp_path: Path, content: bytes, why: str
) -> None:
    (tmp_path / "x.jpg").write_bytes(content)
    with pytest.raises(UnusableFile, match=why):
        read_image(tmp_path / "x.jpg")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnusableFile, match=r"none\.png"):
        read_image(tmp_path / "none.png")


def image_file_announcing(image: Image, kind: str, height: int, width: int) -> bytes:
    """Return a small image file whose header announces an image of this size."""
    data = bytearray(cv2.imencode(kind, image)[1].tobytes())
    if kind == ".png":
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    else:
        head = data.index(b"\xff\xc0")
        data[head + 5 : head + 9] = struct.pack(">HH", height, width)
    return bytes(data)


@pytest.mark.parametrize("kind", [".jpg", ".png"])
def test_a_small_file_that_announces_gigabytes_is_refused_before_decoding(
    tmp_path: Path, image: Image, kind: str
) -> None:
    path = tmp_path / f"bomb{kind}"
    path.write_bytes(image_file_announcing(image, kind, 30_000, 30_000))
    with pytest.raises(UnusableFile, match="too large"):
        read_image(path)


def test_a_file_of_terabytes_is_not_read(tmp_path: Path, image: Image) -> None:
    path = tmp_path / "huge.png"
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    os.truncate(path, 1 << 40)
    with pytest.raises(UnusableFile, match="too large"):
        read_image(path)


def test_a_folder_is_no_image(tmp_path: Path) -> None:
    with pytest.raises(UnusableFile, match="is not a file"):
        read_image(tmp_path)
