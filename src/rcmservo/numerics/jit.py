"""Compilation of kernels by Numba: cached, and never with fastmath.

A kernel is a function with the decorator `compiled`. Numba itself is loaded on the first call of a
kernel, so a command that computes nothing starts without it. Numba's cache looks only at the file
of the compiled function and would miss an edit in another file whose functions it calls. The cache
folder is therefore named by a hash over all files with kernels, and everything that a kernel uses
must be in such a file.
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
DECORATOR_LINE = "\n@compiled\n"
KERNEL_FILE_MARKS = DECORATOR_LINE, "\n@declared(", "\ndeclare_in("
"""Lines that mark a file whose text determines machine code."""

JIT_IS_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "") not in ("", "0")
"""True if kernels stay plain Python, the oracle of the compiled ones."""


def find_kernel_files() -> list[Path]:
    """Return the files of this package that compiled functions are made of."""
    texts = ((path, path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py")))
    return [path for path, text in texts if any(mark in text for mark in KERNEL_FILE_MARKS)]


def count_kernels() -> int:
    """Return the number of compiled functions of this package."""
    return sum(path.read_text("utf-8").count(DECORATOR_LINE) for path in find_kernel_files())


def _list_cache_parents() -> Iterator[Path]:
    """Yield the folders that may hold the cache, the preferred one first."""
    yield PACKAGE / "__pycache__"
    home = os.environ.get("XDG_CACHE_HOME")
    yield Path(home) / "rcmservo" if home else Path("~/.cache/rcmservo")
    user = os.getuid() if hasattr(os, "getuid") else 0
    yield Path(tempfile.gettempdir()) / f"rcmservo-{user}"


@cache
def find_cache_folder() -> str:
    """Return a writable folder for compiled code; empty if there is none."""
    source = b"".join(path.read_bytes() for path in find_kernel_files())
    name = f"numba-{hashlib.sha256(source).hexdigest()[:16]}"
    for parent in _list_cache_parents():
        try:
            folder = parent.expanduser() / name
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except (OSError, RuntimeError):  # not writable; an unknown home folder
            continue
    return ""


def is_cache_empty() -> bool:
    """Return True if compiled code is kept on disk, but none is there yet."""
    folder = os.environ.get("NUMBA_CACHE_DIR") or find_cache_folder()
    return bool(folder) and not JIT_IS_DISABLED and not any(Path(folder).rglob("*.nbi"))


NUMBA_OPTIONS: Any = {"error_model": "numpy", "no_cfunc_wrapper": True, "forceinline": True}
"""Options of functions that Python calls. No function is called from C: without the wrapper for
such calls, compilation takes four fifths of the time. Called functions are inlined, because passing
all numbers of a tick as arguments took as long as computing them."""

INNER_NUMBA_OPTIONS: Any = {**NUMBA_OPTIONS, "no_cpython_wrapper": True}
"""Options of functions that other compiled functions call. The code that unpacks Python's objects
takes a third of the compilation of a small function, and most functions do not need it."""

DECLARING_MODULES: list[str] = []
"""Modules that extend Numba; they are imported before a kernel is compiled."""

_CACHE_FOLDER_LOCK = Lock()


def declare_in(module: str) -> None:
    """Register a module that declares the compiled form of some functions.

    The module imports Numba, so it is imported only before a kernel is compiled.
    """
    DECLARING_MODULES.append(module)


class Kernel:
    """Function that Numba compiles on its first call; until then Numba is not imported.

    The plain function is `py_func`. Numba's object for calls from Python is `dispatcher`, the one
    for calls from other kernels is `inner`. Other attributes are those of `dispatcher`.
    """

    py_func: Callable[..., Any]

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self.dispatcher(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        """Make a dispatcher on its first use, or return an attribute of the one for Python."""
        if name == "inner":
            return vars(self).setdefault(name, _make_dispatcher(self.py_func, INNER_NUMBA_OPTIONS))
        if name == "dispatcher":
            dispatcher = vars(self).setdefault(name, _make_dispatcher(self.py_func, NUMBA_OPTIONS))
            # further calls reach the dispatcher without a Python frame: 0.1 us instead of 0.3
            loaded: Any = type("LoadedKernel", (Kernel,), {"__call__": staticmethod(dispatcher)})
            self.__class__ = loaded
            return dispatcher
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> str:
        """Pickle as plain functions are: by name."""
        return self.py_func.__qualname__


def compiled(function: Function) -> Function:
    """Compile `function` on its first call.

    With NUMBA_DISABLE_JIT=1 it stays plain Python, the oracle of the compiled form.
    """
    return function if JIT_IS_DISABLED else cast(Function, Kernel(function))


def _make_dispatcher(function: Callable[..., Any], options: Any) -> Any:
    """Return Numba's dispatcher of a function, with the cache in the folder of this package.

    Each set of options has a folder of its own, because Numba's cache does not distinguish them.
    """
    numba, config = _import_numba()
    for module in DECLARING_MODULES:
        import_module(module)
    with _CACHE_FOLDER_LOCK:
        user_folder = config.CACHE_DIR
        folder = user_folder or find_cache_folder()
        has_inner_folder = folder and options is INNER_NUMBA_OPTIONS
        config.CACHE_DIR = str(Path(folder) / "inner") if has_inner_folder else folder
        try:
            return numba.njit(cache=bool(folder), **options)(function)
        finally:
            config.CACHE_DIR = user_folder


@cache
def _import_numba() -> tuple[Any, Any]:
    """Import Numba and its configuration; declare the type of kernels that other kernels call."""
    import numba
    from numba import extending
    from numba.core import config

    typeof: Any = extending.typeof_impl

    @typeof.register(Kernel)
    def _(kernel: Kernel, context: Any) -> Any:
        return typeof(kernel.inner, context)

    return numba, config
