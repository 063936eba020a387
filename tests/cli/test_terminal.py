"""Printing of the commands: plain text without cropping, readable on an ASCII terminal."""

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from rcmservo.cli.cli import main
from rcmservo.cli.result_output import print_result
from rcmservo.cli.score_report import convert_score_to_json, print_score
from rcmservo.cli.terminal import open_console, use_ascii_fallback
from rcmservo.interfaces import Floats
from rcmservo.loop.run_result import FeatureError, JacobianError, RunResult
from rcmservo.recording.foreign.length_fit import LengthEstimate
from rcmservo.recording.foreign.scoring import RecordingScore

LONG = f"runs/{'a folder with a long name/' * 6}[/y]"
RESULT = RunResult(cause="[b]too far[/b]", folder=LONG)


def command(*words: str, **variables: str) -> subprocess.CompletedProcess[bytes]:
    """Run `python -m rcmservo` in a separate process."""
    return subprocess.run(
        [sys.executable, "-m", "rcmservo", *words],
        env=os.environ | variables,
        capture_output=True,
        check=False,
    )


def test_a_score_keeps_the_units_in_brackets() -> None:
    steps = {"no_motion": np.array([1.0, 2.0, np.nan])}
    scored = make_score(steps, [])
    assert convert_score_to_json(scored)["reprojection_rms_px"] == {"m1": 0.5, "m2": None}
    text = print_to_text(scored)
    for words in ("s [°]", "r [px]", "d [px]", "marker 1 0.50 px, marker 2 –"):
        assert words in text
    assert "rig file" not in text


def test_a_length_is_printed_with_its_interval_or_as_undetermined() -> None:
    """The limit is ± 5 mm."""
    lengths = [
        LengthEstimate("insertion_zero", -15.6, -12.0, 5.01),
        LengthEstimate("spacing", 50.0, 52.5, 4.99),
        LengthEstimate("marker_1_off_axis_along_yaw", 0.0, 0.0, np.inf),
        LengthEstimate("marker_1_off_axis_along_pitch", 0.0, -0.8, 0.04),
    ]
    scored = make_score({}, lengths)
    rows = [line.split("│")[1:4] for line in print_to_text(scored).splitlines() if "│" in line]
    assert [[cell.strip() for cell in row] for row in rows] == [
        ["insertion zero", "-15.6 mm", "undetermined: this motion fixes it to ± 5.0 mm only"],
        ["spacing", "50.0 mm", "52.5 ± 5.0 mm"],
        ["marker 1 off axis along yaw", "0.0 mm", "undetermined: this motion does not fix it"],
        ["marker 1 off axis along pitch", "0.0 mm", "-0.80 ± 0.04 mm"],
    ]
    assert convert_score_to_json(scored)["lengths_mm"] == {
        "insertion_zero": {"rig_file": -15.6, "estimate": None, "half_width": 5.01},
        "spacing": {"rig_file": 50.0, "estimate": 52.5, "half_width": 4.99},
        "marker_1_off_axis_along_yaw": {"rig_file": 0.0, "estimate": None, "half_width": None},
        "marker_1_off_axis_along_pitch": {"rig_file": 0.0, "estimate": -0.8, "half_width": 0.04},
    }


def make_score(steps: dict[str, Floats], lengths: list[LengthEstimate]) -> RecordingScore:
    """Return a score without frames."""
    reprojection = np.array([0.5, np.nan])
    return RecordingScore([], [], np.array([1.0, 2.0]), 3.0, reprojection, steps, lengths)


def print_to_text(score: RecordingScore) -> str:
    """Return what `print_score` prints."""
    out = Console(width=120, markup=False)
    with out.capture() as got:
        print_score(out, score)
    return got.get()


def test_a_folder_name_that_looks_like_markup_gives_no_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x[").mkdir()
    (tmp_path / "x[" / "y]").write_text("content")
    assert main(["show", str(tmp_path), "--out", str(tmp_path / "x[/y]")]) == 2
    out = open_console()
    with out.capture() as got:
        print_result(out, RESULT, as_json=False)
    assert "[b]too far[/b]" in got.get()


@pytest.mark.parametrize("columns", ["80", "40", None])
def test_a_path_is_complete_on_one_line_at_any_terminal_width(
    columns: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns:
        monkeypatch.setenv("COLUMNS", columns)
    out = open_console()
    with out.capture() as got:
        print_result(out, RESULT, as_json=False)
    assert f"files in {LONG}\n" in got.get()


def test_a_narrow_table_folds_its_words_without_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    out, word = open_console(), "0123456789" * 12
    with out.capture() as got:
        print_result(out, RunResult(cause=word), as_json=False)
    digits = "".join(sign for sign in got.get() if sign.isdigit())
    assert word in digits


def test_an_ascii_terminal_receives_readable_ascii(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    use_ascii_fallback()
    result = RunResult(
        feature_error=FeatureError(0.01, 1.0, 2.0), jacobian_error=JacobianError(0.1, 0.1)
    )
    print_result(Console(file=stream, markup=False, width=100), result, as_json=False)
    print("52.5 ± 4.2 mm", file=stream)
    stream.flush()
    text = stream.buffer.getvalue().decode("ascii")  # type: ignore[attr-defined]
    assert "s 0.573 deg, r 1.00 px" in text and "|J - J|/|J|" in text and "?" not in text
    assert "52.5 +- 4.2 mm" in text


@pytest.mark.parametrize(
    "words",
    [
        ["run", "--help"],
        ["run", "--seed", "°"],
        pytest.param(["--help"], marks=pytest.mark.slow),
    ],
)
def test_every_help_and_error_can_be_printed_in_ascii(words: list[str]) -> None:
    done = command(*words, PYTHONIOENCODING="ascii", LC_ALL="C")
    assert done.returncode == (2 if "°" in words else 0)
    assert b"Traceback" not in done.stderr and (done.stdout + done.stderr).isascii()


def test_ctrl_c_during_loading_gives_130_and_no_traceback() -> None:
    """The signal arrives at imports of the package and of large libraries."""
    program = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == WHERE:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
sys.argv[1:] = ["run"]
from rcmservo.__main__ import main
sys.exit(main())
"""
    for where in ("rcmservo.cli.cli", "numba", "rcmservo.control.saturated_controller", "tyro"):
        words = [sys.executable, "-c", program.replace("WHERE", repr(where))]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (130, "rcmservo: stopped by Ctrl-C\n"), where


def test_the_command_handles_ctrl_c_before_it_loads_slow_libraries() -> None:
    program = "import sys, rcmservo.__main__; print('numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.stdout == "False\n"


def test_python_m_rcmservo_prints_its_version() -> None:
    import rcmservo

    done = command("--version")
    assert (done.returncode, done.stdout) == (0, f"rcmservo {rcmservo.__version__}\n".encode())


def test_the_command_starts_without_a_writable_home_folder_on_an_ascii_terminal(
    tmp_path: Path,
) -> None:
    nowhere = str(tmp_path / "file" / "below")
    (tmp_path / "file").write_text("")
    words, variables = ["run", "--disturb", "help"], {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    done = command(*words, HOME=nowhere, XDG_CACHE_HOME=nowhere, **variables)
    assert (done.returncode, done.stderr) == (0, b"") and done.stdout.isascii()
