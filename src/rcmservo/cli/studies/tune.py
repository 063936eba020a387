"""`rcmservo tune`: search for settings by studies, and test them on scenes outside the search."""

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
    """Search for a method's settings by studies, and test the result on scenes outside the search.

    Parameters
    ----------
    file : Path
        TOML file of a study with one method, with [search] and [tune]; see docs/studies.md.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def tune(options: TuneOptions) -> int:
    """Search, test, and write settings and report; return the exit code 0."""
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
            with progress(out, "testing on unseen scenes", plan.runs, done, "runs") as advance:
                work.go(crew, advance)
        rows = work.gather()
        write_whole(folder / TUNED, settings_text(method, work.own, tuning))
        header = report_header(work) | _search_summary(tuning, method, tried, folder / TUNED)
        written = report.write(folder, work.plan, rows, header, page=True)
    is_better = found.number > 0
    out.print(
        header["found"] if is_better else "no settings better than the initial ones were found"
    )
    out.print("on scenes outside the search:")
    out.print(results(written.summaries))
    for comparison in written.comparisons:
        out.print(beside(comparison), soft_wrap=True)
    out.print(f"settings in {folder / TUNED}, report in {folder}", soft_wrap=True)
    out.print(f"to use them: {run_command(method)}", soft_wrap=True)
    return 0


def _tuning(options: TuneOptions) -> "Tuning":
    """Return the search that a file describes."""
    from rcmservo.study.plan.file import load, plan_of
    from rcmservo.study.tuning.search import TuneSection, Tuning
    from rcmservo.study.tuning.space import axis_from

    study_file = load(options.file)
    with told_with(options.file):
        section = decode(TuneSection, study_file.tune, "tune")
        plan = plan_of(study_file, {name: named(name, "--own") for name in options.own})
        method = plan.methods[0]
        axes = tuple(
            axis_from(name, description, method) for name, description in study_file.search.items()
        )
        return Tuning(plan=plan, axes=axes, **asdict(section))


def _print_search(out: Console, tuning: "Tuning", folder: Path, search: Path) -> None:
    """Print the size of the search, and whether it resumes.

    Each trial has its own method, so a change of the method does not count.
    """
    from rcmservo.study.execution import manifest

    words = f"{tuning.trials} trials of {tuning.plan.runs} simulated runs, into {folder}"
    out.print(words, style="dim", soft_wrap=True)
    previous = manifest.read(search)
    if previous is None:
        return
    changed = manifest.changed(previous, manifest.note_of(tuning.plan))
    differences = ", ".join(word for word in changed if word != manifest.METHOD)
    out.print(
        f"{differences} changed since the last use of this folder: trials are repeated"
        if differences
        else "existing trials are not repeated",
        soft_wrap=True,
    )


def _search_summary(
    tuning: "Tuning", method: "StudyMethod", tried: "list[Tried]", settings: Path
) -> dict[str, object]:
    """Return the entries of a report on the search."""
    from rcmservo.study.tuning.space import value_of

    plan, start = tuning.plan, tuning.plan.methods[0]
    costs = tried[0].cost, min(one.cost for one in tried)
    seeds = f"seeds {plan.first_seed} to {plan.first_seed + plan.count - 1}"
    changes: list[str] = []
    for axis in tuning.axes:
        old, new = (_format_value(value_of(one, axis.name)) for one in (start, method))
        changes.append(f"{axis.name} {old} -> {new}")
    return {
        "search": f"{len(tried)} trials of {plan.runs} runs, {seeds}; goal {tuning.goal}, "
        f"initial and best value: {costs[0]:.3f}, {costs[1]:.3f}",
        "found": ", ".join(changes),
        "settings": str(settings),
    }


def _format_value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def run_command(method: "StudyMethod") -> str:
    """Return the `rcmservo run` command with these settings."""
    arguments = ["rcmservo", "run", "--estimator", name_of(method.estimator, ESTIMATORS)]
    for settings in method.parts.values():
        kind = cast(type[Any], type(settings))
        group, defaults = option_group(kind, RunOptions), kind()
        for f in fields(kind):
            value = getattr(settings, f.name)
            if value != getattr(defaults, f.name):
                arguments += _option_words(f"{group}.{f.name}".replace("_", "-"), value)
    return shlex.join(arguments)


def _option_words(name: str, value: Any) -> list[str]:
    """Return a setting as arguments of a command line."""
    if isinstance(value, bool):
        group, _, key = name.partition(".")
        return [f"--{name}" if value else f"--{group}.no-{key}"]
    return [
        f"--{name}",
        *map(str, cast(tuple[Any, ...], value) if isinstance(value, tuple) else (value,)),
    ]


def settings_text(method: "StudyMethod", own: "Own", tuning: "Tuning") -> str:
    """Return the method with all its settings as a file that `rcmservo study` reads."""
    names = {kind: name for name, kind in own.items()}
    lines = [f"# Found by rcmservo tune: {tuning.trials} trials, goal {tuning.goal}."]
    for part, settings in method.parts.items():
        kind = cast(type[Any], type(settings))
        name = names.get(kind) or name_of(settings, PARTS[part])
        values = {"kind": name, **{f.name: getattr(settings, f.name) for f in fields(kind)}}
        # numbers, strings, lists, true and false have the same form in JSON and TOML
        lines.append(f"[method.{method.name}.{part}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    return "\n".join(lines) + "\n"
