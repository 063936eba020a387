"""`rcmservo tune`: settings found by study, tried on scenes that the search has not seen."""

import json
import shlex
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import tyro
from rich.console import Console

from rcmservo.cli.folders import dated_folder
from rcmservo.cli.lab_options import RunOptions
from rcmservo.cli.progress.progress import progress, resume_hint
from rcmservo.cli.servo_options import option_group
from rcmservo.cli.studies.study import WorkOptions, report_header, require_other_folder, workers_for
from rcmservo.cli.studies.study_report import beside, print_work, results
from rcmservo.cli.terminal import console
from rcmservo.config.atomic_files import write_whole
from rcmservo.config.registry import ESTIMATORS, PARTS, name_of
from rcmservo.config.rig_file import told_with
from rcmservo.config.strict_decoding import decode
from rcmservo.config.user_code import named
from rcmservo.errors import needing

if TYPE_CHECKING:
    from rcmservo.study.plan.method import Own, StudyMethod
    from rcmservo.study.tuning.search import Tried, Tuning


@dataclass(frozen=True)
class TuneOptions(WorkOptions):
    """Search a method's settings by study, and try what was found on scenes that the search has not
    seen.

    Parameters
    ----------
    file : Path
        TOML file of a study with one method, with [search] and [tune]; docs/studies.md shows one.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def tune(options: TuneOptions) -> int:
    """Search, try, and write settings and report."""
    with needing("a study", "study"):
        from rcmservo.study.execution.run_study import Work
        from rcmservo.study.execution.store import SEARCH, TUNED
        from rcmservo.study.report import report
        from rcmservo.study.tuning.search import best, searched
        from rcmservo.study.tuning.space import with_values
    tuning, out = _tuning(options), console()
    folder = options.out or dated_folder("tune")
    require_other_folder(options.file, folder)
    start = tuning.plan.methods[0]
    unseen = Work(tuning.unseen, folder)
    _print_search(out, tuning, folder, folder / SEARCH)
    with resume_hint(folder, out):
        with workers_for(unseen, options, out) as crew:
            with progress(out, "searching", tuning.trials) as advance:
                tried = searched(tuning, folder / SEARCH, crew, lambda _: advance(1))
            found = best(tried)
            method = with_values(start, tuning.name, found.values)
            plan = replace(tuning.unseen, methods=(start, method))
            work = Work(plan, folder)
            print_work(out, work)
            done = plan.runs - work.runs_left
            with progress(out, "trying on unseen scenes", plan.runs, done, "runs") as advance:
                work.go(crew, advance)
        rows = work.gather()
        write_whole(folder / TUNED, settings_text(method, work.own, tuning))
        made = report_header(work) | _search_summary(tuning, method, tried, folder / TUNED)
        told = report.write(folder, work.plan, rows, made, page=True)
    better = found.number > 0
    out.print(
        made["found"] if better else "nothing better than the settings at the start was found"
    )
    out.print("on scenes that the search has not seen:")
    out.print(results(told.summaries))
    for one in told.comparisons:
        out.print(beside(one), soft_wrap=True)
    out.print(f"settings in {folder / TUNED}, report in {folder}", soft_wrap=True)
    out.print(f"to run with them: {run_command(method)}", soft_wrap=True)
    return 0


def _tuning(options: TuneOptions) -> "Tuning":
    """What a file asks for."""
    from rcmservo.study.plan.file import load, plan_of
    from rcmservo.study.tuning.search import TuneSection, Tuning
    from rcmservo.study.tuning.space import axis_from

    asked = load(options.file)
    with told_with(options.file):
        section = decode(TuneSection, asked.tune, "tune")
        plan = plan_of(asked, {name: named(name, "--own") for name in options.own})
        method = plan.methods[0]
        axes = tuple(axis_from(name, told, method) for name, told in asked.search.items())
        return Tuning(plan=plan, axes=axes, **asdict(section))


def _print_search(out: Console, tuning: "Tuning", folder: Path, search: Path) -> None:
    """What is going to be searched, and whether it goes on. Each trial has a method of its own."""
    from rcmservo.study.execution import manifest

    words = f"{tuning.trials} trials of {tuning.plan.runs} simulated runs, into {folder}"
    out.print(words, style="dim", soft_wrap=True)
    before = manifest.read(search)
    if before is None:
        return
    changed = manifest.changed(before, manifest.note_of(tuning.plan))
    other = ", ".join(word for word in changed if word != manifest.METHOD)
    out.print(
        f"{other} changed since this folder was used last: trials are made anew"
        if other
        else "trials that are there already are not made again",
        soft_wrap=True,
    )


def _search_summary(
    tuning: "Tuning", method: "StudyMethod", tried: "list[Tried]", settings: Path
) -> dict[str, object]:
    """What a report says of the search."""
    from rcmservo.study.tuning.space import value_of

    plan, start = tuning.plan, tuning.plan.methods[0]
    costs = tried[0].cost, min(one.cost for one in tried)
    seeds = f"seeds {plan.first_seed} to {plan.first_seed + plan.count - 1}"
    changes = [
        f"{axis.name} {_format_value(value_of(start, axis.name))} -> {_format_value(value_of(method, axis.name))}"
        for axis in tuning.axes
    ]
    return {
        "search": f"{len(tried)} trials of {plan.runs} runs, {seeds}; goal {tuning.goal}, at the "
        f"start and at the best: {costs[0]:.3f}, {costs[1]:.3f}",
        "found": ", ".join(changes),
        "settings": str(settings),
    }


def _format_value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def run_command(method: "StudyMethod") -> str:
    """How `rcmservo run` takes these settings."""
    words = ["rcmservo", "run", "--estimator", name_of(method.estimator, ESTIMATORS)]
    for settings in method.parts.values():
        kind = cast(type[Any], type(settings))
        group, usual = option_group(kind, RunOptions), kind()
        for f in fields(kind):
            value = getattr(settings, f.name)
            if value != getattr(usual, f.name):
                words += _option_words(f"{group}.{f.name}".replace("_", "-"), value)
    return shlex.join(words)


def _option_words(name: str, value: Any) -> list[str]:
    """A setting as words of a command line."""
    if isinstance(value, bool):
        group, _, key = name.partition(".")
        return [f"--{name}" if value else f"--{group}.no-{key}"]
    return [
        f"--{name}",
        *map(str, cast(tuple[Any, ...], value) if isinstance(value, tuple) else (value,)),
    ]


def settings_text(method: "StudyMethod", own: "Own", tuning: "Tuning") -> str:
    """The method as a file that `rcmservo study` reads: all its settings."""
    named_own = {kind: name for name, kind in own.items()}
    lines = [f"# Found by rcmservo tune: {tuning.trials} trials, goal {tuning.goal}."]
    for part, settings in method.parts.items():
        kind = cast(type[Any], type(settings))
        name = named_own.get(kind) or name_of(settings, PARTS[part])
        given = {"kind": name, **{f.name: getattr(settings, f.name) for f in fields(kind)}}
        # JSON's numbers, words, lists, true and false are TOML's too
        lines.append(f"[method.{method.name}.{part}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in given.items()]
    return "\n".join(lines) + "\n"
