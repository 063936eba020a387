"""JSON encoding of what browsers receive."""

from typing import Any

from pydantic_core import to_json


def encode_json(value: object) -> bytes:
    """Encode a value as JSON: dataclasses as tables, arrays as lists, NaN and infinity as null."""
    return to_json(value, inf_nan_mode="null", fallback=_to_plain)


def _to_plain(array: Any) -> Any:
    """Convert an array or a NumPy scalar to plain Python."""
    return array.tolist()
