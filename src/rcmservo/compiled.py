"""The one way in which rcmservo compiles a function: Numba, cached, IEEE arithmetic kept (never fastmath).

Numba's cache looks only at the file of the compiled function, so that an edit in a file it calls would go unseen.
Ours lies in a folder named by a hash over the whole package: new source, new cache.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config as numba_config

Function = TypeVar("Function", bound=Callable[..., Any])
PACKAGE = Path(__file__).parent


def _source_hash() -> str:
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


config: Any = numba_config
_CACHE = str(PACKAGE / "__pycache__" / f"numba-{_source_hash()}")


def compiled(function: Function) -> Function:
    """Compile `function` on its first call. With NUMBA_DISABLE_JIT=1 it stays readable Python: the oracle."""
    chosen = config.CACHE_DIR
    config.CACHE_DIR = chosen or _CACHE
    try:
        return cast(Function, numba.njit(cache=True, error_model="numpy")(function))
    finally:
        config.CACHE_DIR = chosen
