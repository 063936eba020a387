"""`rcmservo live`: what its table and its JSON tell."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcmservo.app.cli import main
from rcmservo.app.live import LiveMetrics, LiveOptions, kept, metrics_of, show_live
from rcmservo.app.simulated_run.metrics import METRICS
from rcmservo.app.terminal import console
from rcmservo.live.reports import LiveResult, LoopTiming, Spread
from rcmservo.record.verdict import Outcome

CAUSE = "the servo process was killed (SIGKILL)"


def fallen(**more: Any) -> LiveMetrics:
    outcome = Outcome(False, CAUSE, None, np.full(3, np.nan), None)
    return metrics_of(LiveOptions(), Path("runs/[a]"), LiveResult(outcome, **more), 3.0)


def printed(**more: Any) -> str:
    out = console()
    with out.capture() as got:
        show_live(out, fallen(**more))
    return got.get()


def test_a_live_run_tells_what_could_not_be_recorded() -> None:
    text = printed(not_recorded="No space left on [device]")
    assert "not recorded" in text and "No space left on [device]" in text
    assert "not recorded" not in printed()


def test_a_live_result_that_cannot_be_written_is_told_and_not_lost(tmp_path: Path) -> None:
    """A folder where the metrics' file would grow stands for a disk that is full."""
    (tmp_path / f"{METRICS}.part").mkdir()
    metrics = kept(tmp_path, fallen())
    assert f"{METRICS}: cannot be written" in metrics.not_written
    out = console()
    with out.capture() as got:
        show_live(out, metrics)
    assert "not written" in got.get() and "not written" not in printed()


def test_a_live_run_names_its_cause_its_folder_and_how_the_loop_kept_its_time() -> None:
    timing = LoopTiming(200, 2, 99.5, Spread(0.25, 0.5, 1.5), Spread(), 0, ["paging [1] may delay"])
    text = " ".join(printed(timing=timing).replace("│", " ").split())
    for words in (CAUSE, "runs/[a]", "2 of 200", "99.500 Hz", "p99 0.50 ms", "paging [1]", "p99 –"):
        assert words in text
    assert "lateness" not in printed()


def test_what_is_not_known_is_none_in_json() -> None:
    plain = json.loads(
        json.dumps(asdict(fallen(timing=LoopTiming(0, 0, np.nan, Spread(), Spread(), 0))))
    )
    assert plain["loop"]["rate_hz"] is None and plain["loop"]["lateness_ms"]["p99"] is None
    assert plain["feature_error"] == {"s_rad": None, "r_px": None, "d_px": None}
    assert "NaN" not in json.dumps(asdict(fallen()))


@pytest.mark.parametrize(
    "words,sentence",
    [
        (["--seed", "-1"], "--seed must be a whole number"),
        (["--duration", "0.5"], "--duration must be more than 1"),
        (["--rig", "none.toml"], "none.toml"),
        (["--frames"], "--frames"),
    ],
)
def test_what_live_cannot_use_is_one_sentence_and_leaves_no_folder(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["live", *words, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1
    assert not out.exists()


def test_run_has_no_live_any_more(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--live", "--out", str(tmp_path / "out")]) == 2
    assert "--live" in capsys.readouterr().err
