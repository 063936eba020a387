"""The one way in which rcmservo compiles a function: Numba, cached, never with fastmath.

Numba's cache looks only at the file of the compiled function. An edit in a file that it calls would
go unseen. So ours lies in a folder that is named by a hash over all files that compiled functions
are made of: new source, new cache. Whatever a compiled function uses must stand in such a file.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config as numba_config

Function = TypeVar("Function", bound=Callable[..., Any])
PACKAGE = Path(__file__).parent
MARK, NATIVE = "\n@compiled\n", "\n@intrinsic\n"


def sources() -> list[Path]:
    """The files of this package that compiled functions are made of."""
    texts = ((path, path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py")))
    return [path for path, text in texts if MARK in text or NATIVE in text]


def parts() -> int:
    """How many functions of this package are compiled."""
    return sum(path.read_text("utf-8").count(MARK) for path in sources())


def _source_hash() -> str:
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _places() -> Iterator[Path]:
    """Where compiled code may be kept, the best place first."""
    yield PACKAGE / "__pycache__"
    home = os.environ.get("XDG_CACHE_HOME")
    yield Path(home) / "rcmservo" if home else Path("~/.cache/rcmservo")
    user = os.getuid() if hasattr(os, "getuid") else 0
    yield Path(tempfile.gettempdir()) / f"rcmservo-{user}"


def _cache() -> str:
    """A folder for compiled code that can be written to; empty where there is none."""
    name = f"numba-{_source_hash()}"
    for place in _places():
        try:
            folder = place.expanduser() / name
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except (OSError, RuntimeError):  # not writable; a home that nobody knows
            continue
    return ""


config: Any = numba_config
OPTIONS: Any = {"error_model": "numpy", "no_cfunc_wrapper": True, "forceinline": True}
"""Nothing here is called from C: without what that needs it compiles in four fifths of the time.
What one function calls becomes part of it: to pass on all the numbers of a tick took as long as to
compute them."""

_CACHE = _cache()


def compiled(function: Function) -> Function:
    """Compile `function` on its first call.

    With NUMBA_DISABLE_JIT=1 it stays readable Python: the oracle.
    """
    chosen = config.CACHE_DIR
    config.CACHE_DIR = chosen or _CACHE
    try:
        kept = bool(config.CACHE_DIR)
        return cast(Function, numba.njit(cache=kept, **OPTIONS)(function))
    finally:
        config.CACHE_DIR = chosen
