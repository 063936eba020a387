"""Lossless compression of the table of a recorded loop.

Quantised values are stored as differences of integers, words as indices of a list, and applied
rates as the bits that differ from the commands; xz compresses the result.
"""

import io
import lzma
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
Table = dict[str, Array]

JOINTS = 2.0**20, 2.0**20, 2.0**14
"""Quantisation steps per rad, rad and mm."""
PIXELS = 2.0**10
"""Quantisation steps per px."""
STEPS = np.array([*JOINTS, *JOINTS, *[PIXELS] * 6])
"""Quantisation steps per unit of q, q_exposure, points and sizes."""
APPLIED = slice(3, 6)
"""Columns of `reals` that are not quantised."""
LOST = np.iinfo(np.int32).min
"""Integer that represents NaN."""


def write(path: Path, table: Table) -> None:
    """Write a table with quantised joints and markers."""
    file = io.BytesIO()
    other_columns = {name: table[name] for name in table.keys() - {"integers", "reals", "words"}}
    names, words = np.unique(table["words"], return_inverse=True)
    steps = np.delete(table["reals"], APPLIED, axis=1) * STEPS
    whole = np.where(np.isnan(steps), LOST, steps).astype(np.int32)
    sent = before(table["rates"]).view(np.int64)
    np.savez(
        file,
        **other_columns,
        integers=np.diff(table["integers"], axis=0, prepend=0),
        steps=np.diff(whole, axis=0, prepend=np.int32(0)),
        taken=table["reals"][:, APPLIED].copy().view(np.int64) ^ sent,
        names=names,
        words=words.reshape(table["words"].shape).astype(np.uint8),
    )
    path.write_bytes(lzma.compress(file.getvalue(), preset=9))


def read(path: Path) -> Table:
    """Read a table."""
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
    """Return the commanded rates of the previous tick."""
    return np.vstack([np.zeros((1, 3)), rates[:-1]])
