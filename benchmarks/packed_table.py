"""The table of a recorded loop in few bytes, exactly.

Steps are kept as differences of whole numbers, words as numbers of a list, and commands that the
arm took as the bits that differ from those that were sent; then xz compresses all.
"""

import io
import lzma
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
Table = dict[str, Array]

JOINTS = 2.0**20, 2.0**20, 2.0**14
"""Steps in a rad, a rad, a mm."""
PIXELS = 2.0**10
"""Steps in a px."""
STEPS = np.array([*JOINTS, *JOINTS, *[PIXELS] * 6])
"""Of q, q_exposure, points and sizes."""
APPLIED = slice(3, 6)
"""The columns of `reals` that are not steps."""
LOST = np.iinfo(np.int32).min
"""The whole number that stands for NaN."""


def write(path: Path, table: Table) -> None:
    """Write a table whose joints and markers are whole steps."""
    file = io.BytesIO()
    kept = {name: table[name] for name in table.keys() - {"integers", "reals", "words"}}
    names, words = np.unique(table["words"], return_inverse=True)
    steps = np.delete(table["reals"], APPLIED, axis=1) * STEPS
    whole = np.where(np.isnan(steps), LOST, steps).astype(np.int32)
    sent = before(table["rates"]).view(np.int64)
    np.savez(
        file,
        **kept,
        integers=np.diff(table["integers"], axis=0, prepend=0),
        steps=np.diff(whole, axis=0, prepend=np.int32(0)),
        taken=table["reals"][:, APPLIED].copy().view(np.int64) ^ sent,
        names=names,
        words=words.reshape(table["words"].shape).astype(np.uint8),
    )
    path.write_bytes(lzma.compress(file.getvalue(), preset=9))


def read(path: Path) -> Table:
    """The table that was written."""
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as file:
        table = dict(file)
    whole = np.cumsum(table.pop("steps"), axis=0, dtype=np.int32)
    steps = np.where(whole == LOST, np.nan, whole / STEPS)
    taken = (table.pop("taken") ^ before(table["rates"]).view(np.int64)).view(np.float64)
    return table | {
        "integers": np.cumsum(table["integers"], axis=0),
        "reals": np.hstack([steps[:, :3], taken, steps[:, 3:]]),
        "words": table.pop("names")[table["words"]],
    }


def before(rates: Array) -> Array:
    """What was sent a tick before."""
    return np.vstack([np.zeros((1, 3)), rates[:-1]])
