"""The one way in which rcmservo compiles a function: Numba, cached, never with fastmath.

Numba itself is loaded on the first call of a kernel: a command that computes nothing starts without
it. Numba's cache looks only at the file of the compiled function, so an edit in a file that it
calls would be missed. The cache therefore lies in a folder named by a hash over all files that
kernels are made of: new source, new cache. Whatever a kernel uses must be in such a file.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, update_wrapper
from importlib import import_module
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])
PACKAGE = Path(__file__).parent.parent
MARK = "\n@compiled\n"
MARKS = MARK, "\n@declared(", "\ndeclare_in("
"""Each is in files that machine code is made of."""

PLAIN = os.environ.get("NUMBA_DISABLE_JIT", "") not in ("", "0")
"""True if kernels stay readable Python, the oracle of the compiled ones."""


def sources() -> list[Path]:
    """The files of this package that compiled functions are made of."""
    texts = ((path, path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py")))
    return [path for path, text in texts if any(mark in text for mark in MARKS)]


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


@cache
def cache_folder() -> str:
    """A folder for compiled code that can be written to; empty if there is none."""
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


OPTIONS: Any = {"error_model": "numpy", "no_cfunc_wrapper": True, "forceinline": True}
"""Nothing here is called from C: without what that needs it compiles in four fifths of the time.
What one function calls becomes part of it: to pass on all the numbers of a tick took as long as to
compute them."""

INNER: Any = {**OPTIONS, "no_cpython_wrapper": True}
"""The same for a function that another compiled one calls. The code that takes Python's objects
apart is a third of the compilation of a small function, and most functions need none."""

DECLARING: list[str] = []
"""Modules that extend Numba: they are imported before a kernel is compiled."""

_CHANGING_THE_FOLDER = Lock()


def declare_in(module: str) -> None:
    """Name a module that declares the compiled form of some functions. It imports Numba, so it is
    imported only when a kernel is about to be compiled.
    """
    DECLARING.append(module)


class Kernel:
    """A function that Numba compiles on its first call. Until then Numba is not even imported.

    The plain function is `py_func`. Numba's object for calls from Python is `dispatcher`, that for
    calls from other kernels is `inner`; other attributes are those of the dispatcher.
    """

    py_func: Callable[..., Any]

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.dispatcher(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        """Make a dispatcher, once, or return an attribute of the one for Python."""
        if name == "inner":
            return vars(self).setdefault(name, _dispatcher(self.py_func, INNER))
        if name == "dispatcher":
            made = vars(self).setdefault(name, _dispatcher(self.py_func, OPTIONS))
            # from now on a call reaches it without a frame of Python between: 0.1 us, not 0.3
            loaded: Any = type("LoadedKernel", (Kernel,), {"__call__": staticmethod(made)})
            self.__class__ = loaded
            return made
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> str:
        """Pickle as plain functions are: by name."""
        return self.py_func.__qualname__


def compiled(function: Function) -> Function:
    """Compile `function` on its first call.

    With NUMBA_DISABLE_JIT=1 it stays readable Python: the oracle.
    """
    return function if PLAIN else cast(Function, Kernel(function))


def _dispatcher(function: Callable[..., Any], options: Any) -> Any:
    """Return what Numba makes of a function, with the cache in our folder: one folder for each set
    of options, which Numba does not tell apart there.
    """
    numba, config = _numba()
    for module in DECLARING:
        import_module(module)
    with _CHANGING_THE_FOLDER:
        chosen = config.CACHE_DIR
        folder = chosen or cache_folder()
        config.CACHE_DIR = str(Path(folder) / "inner") if folder and options is INNER else folder
        try:
            return numba.njit(cache=bool(folder), **options)(function)
        finally:
            config.CACHE_DIR = chosen


@cache
def _numba() -> tuple[Any, Any]:
    """Import Numba and its configuration, and declare the type of a kernel that another one
    calls.
    """
    import numba
    from numba import extending
    from numba.core import config

    typeof: Any = extending.typeof_impl

    @typeof.register(Kernel)
    def _(kernel: Kernel, context: Any) -> Any:
        return typeof(kernel.inner, context)

    return numba, config
