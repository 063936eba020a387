"""Tests of compilation before a command's work: its progress, and the second process."""

import io
import multiprocessing
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numba
import pytest
from rich.console import Console
from rich.live import Live

from rcmservo.cli.progress import compilation
from rcmservo.cli.progress.compilation import compiled_in_parallel, report_compilation
from rcmservo.geometry.features import wrap_angle


@pytest.mark.parametrize(("expected", "at_last", "others"), [(100, 100, 3), (2, 4, 0)])
def test_compiled_parts_are_reported_and_other_packages_are_not_counted(
    expected: int, at_last: int, others: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a status line, one line is printed per three parts.

    The stated total is at least the number of compiled parts.
    """
    monkeypatch.setattr(compilation, "count_kernels", lambda: expected)
    monkeypatch.setattr(compilation, "KERNELS_PER_PRINTED_LINE", 3)
    written = io.StringIO()
    with Live(console=Console(file=written, width=80)) as line, report_compilation(line):
        for module in ["other.package"] * others + ["rcmservo.made_up"] * 4:
            numba.njit(uncompiled_function(module))(1.0)
    lines = [one for one in written.getvalue().splitlines() if one.startswith("compiling")]
    end = "parts; the next start is quicker"
    printed_lines = [
        f"compiling, 1 of about {expected} {end}",
        f"compiling, 4 of about {at_last} {end}",
    ]
    assert list(dict.fromkeys(lines)) == printed_lines


def test_a_second_process_compiles_if_nothing_is_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    counted, processes = list[str](), list[int]()
    for run in ("first", "second"):
        with compiled_in_parallel(partial(wrap_angle, 1.0), partial(counted.append, run)):
            processes.append(len(multiprocessing.active_children()))
    assert list(tmp_path.rglob("*.nbi"))
    assert counted == ["first"]
    assert processes == [1, 0]


def test_an_error_of_the_second_process_is_left_to_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with compiled_in_parallel(partial(int, "no number"), pytest.fail):
        pass
    assert capfd.readouterr() == ("", "")


def test_an_interrupted_preparation_leaves_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with (
        pytest.raises(KeyboardInterrupt),
        compiled_in_parallel(signal.pause, pytest.fail),
    ):
        assert multiprocessing.active_children()
        raise KeyboardInterrupt
    assert not multiprocessing.active_children()


def uncompiled_function(module: str) -> Callable[[float], float]:
    """Return a function of a module that is not compiled yet."""

    def double(x: float) -> float:
        return 2.0 * x

    double.__module__ = module
    return double
