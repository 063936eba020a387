"""The claims and figures that both regulation experiments make."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from rcmservo.experiments.harness.claims import Claim, NotMeasured, Shown
from rcmservo.experiments.harness.lab.closed_loop import recorded
from rcmservo.experiments.harness.lab.regulation import (
    ACCURATE,
    PERCENT,
    SEEN,
    SLOPE,
    Regulated,
    Regulation,
    RegulationRun,
    begun,
)
from rcmservo.experiments.harness.statistics import median, share, told
from rcmservo.experiments.harness.tasks import Results
from rcmservo.figures import plots
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.record.reader import Record

MOST = 90.0
"""% of the seeds in which an experiment of the paper is to succeed."""


def succeeds(
    settings: Regulation, runs: Sequence[RegulationRun], about: str, case: tuple[str, str]
) -> Claim:
    """That the errors fall as the paper's do."""
    rest = [
        f"seed {seed}: {run.why_not}"
        for seed, run in zip(settings.seeds, runs, strict=True)
        if not run.succeeded
    ]
    return Claim(
        "every error falls below 2 % of its initial value, in a faithful run: share of the seeds",
        about,
        100.0 * share(run.succeeded for run in runs),
        "% of seeds",
        ">=",
        MOST,
        settings.seeds,
        case=case,
        detail="; ".join([*_starts(settings, runs), _left(runs), *rest]),
        figure="errors",
    )


def _left(runs: Sequence[RegulationRun]) -> str:
    """What the runs that succeeded leave."""
    good = begun(run for run in runs if run.succeeded)
    left = max((float(np.max(one.left)) for one in good), default=np.nan)
    poses = [one.pose for one in good]
    return (
        f"largest error left {told(100.0 * left, '.1f')} %, pose error median "
        f"{told(median(poses))} mm, worst {told(max(poses, default=np.nan))} mm"
    )


def _starts(settings: Regulation, runs: Sequence[RegulationRun]) -> list[str]:
    """How near the runs began to the errors that they were to begin with."""
    if not begun(runs):
        return []
    away = np.array([one.initial for one in begun(runs)]) - settings.errors
    s, r, d = np.max(np.abs(away), axis=0) * plots.DEGREES
    s_0, r_0, d_0 = settings.errors * plots.DEGREES
    return [
        f"initial errors [{s_0:.0f}°, {r_0:.0f} px, {d_0:.0f} px], as the servo measures them "
        f"about its o_c to within {s:.2f}°, {r:.1f} px, {d:.1f} px"
    ]


class OfRuns(NamedTuple):
    """A number of those runs in which it could be measured."""

    seeds: list[int]
    """Of these runs."""
    values: list[float]
    """One for each of them."""
    missing: str
    """In words, of how many runs it is not known; empty if of none."""


def known_of(
    settings: Regulation,
    runs: Sequence[RegulationRun],
    what: str,
    of: Callable[[Regulated], float | None],
) -> OfRuns:
    """A number of every run that left its start and in which it could be measured; NotMeasured if
    there is none."""
    values = [one.regulated and of(one.regulated) for one in runs]
    pairs = [
        (seed, value)
        for seed, value in zip(settings.seeds, values, strict=True)
        if value is not None and np.isfinite(value)
    ]
    if not pairs:
        raise NotMeasured(f"{what}, in any run", float("nan"))
    without = len(runs) - len(pairs)
    missing = f"; not measured in {without} of {len(runs)} runs" if without else ""
    return OfRuns([seed for seed, _ in pairs], [value for _, value in pairs], missing)


def approximates(
    settings: Regulation, runs: Sequence[RegulationRun], case: tuple[str, str]
) -> Claim:
    """That Ĵ is near J when the exploration is done."""
    seeds, errors, missing = known_of(settings, runs, "the error of Ĵ", lambda one: one.explored)
    start = median([one.at_start for one in begun(runs)])
    end = median([one.at_end for one in begun(runs)])
    return Claim(
        "Ĵ approximates J after exploration: scaled ‖Ĵ − J‖/‖J‖, median",
        "real-time",
        median(errors),
        "of ‖J‖",
        "<=",
        ACCURATE,
        seeds,
        case=case,
        detail=f"worst {max(errors):.2f}; at the start {start:.2f}, at the end {end:.2f} "
        f"(medians){missing}",
        figure="seeds",
    )


def falls_by_k_b(
    settings: Regulation, runs: Sequence[RegulationRun], case: tuple[str, str]
) -> Claim:
    """That the gains mean what they say."""
    seeds, slopes, missing = known_of(
        settings, runs, "the slope of r", lambda one: float(one.slopes[1])
    )
    return Claim(
        "k = 0.1 with b = 10 is an error that falls by 1 px/s: |slope of r − 1 px/s|, median",
        "gains",
        median(np.abs(np.array(slopes) - 1.0)),
        "px/s",
        "<=",
        SLOPE,
        seeds,
        follows=True,
        case=case,
        detail=f"slopes {min(slopes):.2f} to {max(slopes):.2f} px/s{missing}",
        figure="seeds",
        trap="T5",
    )


def regulation_figures(
    settings: Regulation,
    results: Results,
    runs: Sequence[RegulationRun],
    case: str,
    paper: tuple[str, str],
) -> list[Shown]:
    """Fig. 7 or 8 (pictures) and 9 or 10 (errors) of the seed shown, and all seeds, in one case."""
    task = f"seed-{settings.shown}"
    rows = recorded(results.folder(task))
    errors = regulation_errors(rows, results.of(RegulationRun, task), settings)
    words = "Magnitude of the error coordinates from the start on."
    caption = (
        f"Every run, {case}: the error of Ĵ after exploration, the slope of r while saturated, and "
        "the largest share of an initial error that is left; dashed: the bounds of a faithful run."
    )
    return [
        *_pictures(settings, results, paper[0]),
        Shown("errors", paper[1], words, [settings.shown], errors),
        Shown("seeds", "All seeds", caption, list(settings.seeds), _seeds(settings, runs)),
    ]


def _pictures(settings: Regulation, results: Results, where: str) -> list[Shown]:
    folder = results.folder(f"seed-{settings.shown}")
    pictures = [folder / name for name in ("initial.png", "final.png")]
    if not all(path.exists() for path in pictures):
        return []
    caption = (
        "Initial and final picture: features y in blue, target y_d in black, imaged RCM as a cross."
    )
    return [Shown("pictures", where, caption, [settings.shown], pictures=pictures)]


def regulation_errors(
    rows: Record, run: RegulationRun, settings: Regulation, until: float = float("inf")
) -> Figure:
    """Magnitude of the error coordinates from the start on, for `until` s: Fig. 9 and 10."""
    began = run.regulated.began if run.regulated else 0.0
    on = (rows.time >= began + SEEN) & (rows.time <= began + until)
    sizes = np.abs(rows.ticks["delta"][on]) * plots.DEGREES
    ends = settings.errors * PERCENT * plots.DEGREES
    panels = [
        Panel(
            "time [s]",
            name,
            [curve("", rows.time[on] - began, sizes[:, i])],
            levels=[("2 %", float(ends[i]))],
        )
        for i, name in enumerate(plots.ERRORS)
    ]
    return Figure("Error coordinates", panels)


def _seeds(settings: Regulation, runs: Sequence[RegulationRun]) -> Figure:
    """Three numbers of every run; a gap for one that never began."""
    found = [run.regulated for run in runs]
    names = [str(seed) for seed in settings.seeds]
    numbers = (
        [one.explored if one else np.nan for one in found],
        [one.slopes[1] if one else np.nan for one in found],
        [100.0 * float(np.max(one.left)) if one else np.nan for one in found],
    )
    labels = ("$\\|\\hat J - J\\| / \\|J\\|$", "slope of r [px/s]", "left [%]")
    levels = (
        [("30 %", ACCURATE)],
        [("", 1.0 - SLOPE), ("", 1.0 + SLOPE)],
        [("2 %", 100.0 * PERCENT)],
    )
    panels = [
        Panel(
            "seed",
            labels[i],
            [curve("", np.arange(len(names)), numbers[i], i, marks=True)],
            levels[i],
            log_y=i == 2,
            categories=names,
        )
        for i in range(3)
    ]
    return Figure("All seeds", panels)
