"""`rcmservo tune`: search for settings by studies, and test them on scenes outside the search."""

import json
import shlex
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import tyro
from rich.console import Console

from rcmservo.cli.folders import make_dated_path
from rcmservo.cli.progress.progress import print_resume_hint, show_progress
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.servo_options import find_option_group
from rcmservo.cli.studies.study import (
    WorkOptions,
    make_report_header,
    open_workers,
    require_other_folder,
)
from rcmservo.cli.studies.study_report import build_result_table, describe_comparison, print_work
from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.registry import ESTIMATORS, PART_CLASSES, find_class_name
from rcmservo.config.rig_file import name_origin_in_errors
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.user_estimators import import_estimator
from rcmservo.errors import require_extra

if TYPE_CHECKING:
    from rcmservo.study.plan.method import StudyMethod, UserEstimators
    from rcmservo.study.tuning.search import SearchTrial, Tuning


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
    with require_extra("a study", "study"):
        from rcmservo.study.execution.run_study import StudyExecution
        from rcmservo.study.execution.store import SEARCH_FOLDER, TUNED_FILE
        from rcmservo.study.report import report
        from rcmservo.study.tuning.search import find_best_trial, run_search
        from rcmservo.study.tuning.space import replace_settings
    tuning, out = read_tuning(options), open_console()
    folder = options.out or make_dated_path("tune")
    require_other_folder(options.file, folder)
    start = tuning.plan.methods[0]
    unseen = StudyExecution(tuning.validation_plan, folder)
    _print_search(out, tuning, folder, folder / SEARCH_FOLDER)
    with print_resume_hint(folder, out):
        with open_workers(unseen, options, out) as crew:
            with show_progress(out, "searching", tuning.trials) as advance:
                tried = run_search(tuning, folder / SEARCH_FOLDER, crew, lambda _: advance(1))
            found = find_best_trial(tried)
            method = replace_settings(start, tuning.method_name, found.values)
            plan = replace(tuning.validation_plan, methods=(start, method))
            work = StudyExecution(plan, folder)
            print_work(out, work)
            done = plan.runs - work.missing_runs
            with show_progress(out, "testing on unseen scenes", plan.runs, done, "runs") as advance:
                work.run(crew, advance)
        rows = work.gather()
        write_atomically(folder / TUNED_FILE, format_settings(method, work.user_estimators, tuning))
        header = make_report_header(work) | _summarise_search(
            tuning, method, tried, folder / TUNED_FILE
        )
        written = report.write_report(folder, work.plan, rows, header, page=True)
    is_better = found.number > 0
    out.print(
        header["found"] if is_better else "no settings better than the initial ones were found"
    )
    out.print("on scenes outside the search:")
    out.print(build_result_table(written.summaries))
    for comparison in written.comparisons:
        out.print(describe_comparison(comparison), soft_wrap=True)
    out.print(f"settings in {folder / TUNED_FILE}, report in {folder}", soft_wrap=True)
    out.print(f"to use them: {format_run_command(method)}", soft_wrap=True)
    return 0


def read_tuning(options: TuneOptions) -> "Tuning":
    """Return the search that a file describes."""
    from rcmservo.study.plan.file import make_plan, read_study_file
    from rcmservo.study.tuning.search import TuneSection, Tuning
    from rcmservo.study.tuning.space import parse_axis

    study_file = read_study_file(options.file)
    with name_origin_in_errors(options.file):
        section = decode_settings(TuneSection, study_file.tune, "tune")
        plan = make_plan(
            study_file,
            {name: import_estimator(name, "--user-estimator") for name in options.user_estimator},
        )
        method = plan.methods[0]
        axes = tuple(
            parse_axis(name, description, method) for name, description in study_file.search.items()
        )
        return Tuning(plan=plan, axes=axes, **asdict(section))


def _print_search(out: Console, tuning: "Tuning", folder: Path, search: Path) -> None:
    """Print the size of the search, and whether it resumes.

    Each trial has its own method, so a change of the method does not count.
    """
    from rcmservo.study.execution import manifest

    words = f"{tuning.trials} trials of {tuning.plan.runs} simulated runs, into {folder}"
    out.print(words, style="dim", soft_wrap=True)
    previous = manifest.read_manifest(search)
    if previous is None:
        return
    changed = manifest.list_changed_settings(previous, manifest.make_manifest(tuning.plan))
    differences = ", ".join(word for word in changed if word != manifest.METHOD_SETTING_NAME)
    out.print(
        f"{differences} changed since the last use of this folder: trials are repeated"
        if differences
        else "existing trials are not repeated",
        soft_wrap=True,
    )


def _summarise_search(
    tuning: "Tuning", method: "StudyMethod", tried: "list[SearchTrial]", settings: Path
) -> dict[str, object]:
    """Return the entries of a report on the search."""
    from rcmservo.study.tuning.space import get_setting

    plan, start = tuning.plan, tuning.plan.methods[0]
    costs = tried[0].cost, min(one.cost for one in tried)
    seeds = f"seeds {plan.first_seed} to {plan.first_seed + plan.count - 1}"
    changes: list[str] = []
    for axis in tuning.axes:
        old, new = (_format_value(get_setting(one, axis.name)) for one in (start, method))
        changes.append(f"{axis.name} {old} -> {new}")
    return {
        "search": f"{len(tried)} trials of {plan.runs} runs, {seeds}; goal {tuning.goal}, "
        f"initial and best value: {costs[0]:.3f}, {costs[1]:.3f}",
        "found": ", ".join(changes),
        "settings": str(settings),
    }


def _format_value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def format_run_command(method: "StudyMethod") -> str:
    """Return the `rcmservo run` command with these settings."""
    arguments = ["rcmservo", "run", "--estimator", find_class_name(method.estimator, ESTIMATORS)]
    for settings in method.parts.values():
        kind = cast(type[Any], type(settings))
        group, defaults = find_option_group(kind, RunOptions), kind()
        for f in fields(kind):
            value = getattr(settings, f.name)
            if value != getattr(defaults, f.name):
                arguments += _format_option(f"{group}.{f.name}".replace("_", "-"), value)
    return shlex.join(arguments)


def _format_option(name: str, value: Any) -> list[str]:
    """Return a setting as arguments of a command line."""
    if isinstance(value, bool):
        group, _, key = name.partition(".")
        return [f"--{name}" if value else f"--{group}.no-{key}"]
    return [
        f"--{name}",
        *map(str, cast(tuple[Any, ...], value) if isinstance(value, tuple) else (value,)),
    ]


def format_settings(method: "StudyMethod", own: "UserEstimators", tuning: "Tuning") -> str:
    """Return the method with all its settings as a file that `rcmservo study` reads."""
    names = {kind: name for name, kind in own.items()}
    lines = [f"# Found by rcmservo tune: {tuning.trials} trials, goal {tuning.goal}."]
    for part, settings in method.parts.items():
        kind = cast(type[Any], type(settings))
        name = names.get(kind) or find_class_name(settings, PART_CLASSES[part])
        values = {"kind": name, **{f.name: getattr(settings, f.name) for f in fields(kind)}}
        # numbers, strings, lists, true and false have the same form in JSON and TOML
        lines.append(f"[method.{method.name}.{part}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    return "\n".join(lines) + "\n"
