"""`rcmservo tune`: search for settings by studies, and test them on scenes outside the search.

Each trial of the search is a study with one candidate of the settings. The best settings are then
compared with the initial ones in scenes that the search did not use.
"""

import json
import shlex
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import tyro
from rich.console import Console

from rcmservo.cli.progress.progress import print_resume_hint, show_progress
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.servo_options import find_option_group
from rcmservo.cli.studies.study import (
    WorkOptions,
    make_report_header,
    open_workers,
    require_other_folder,
)
from rcmservo.cli.studies.study_report import print_results, print_work
from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.class_registry import ESTIMATORS, PART_CLASSES, find_class_name
from rcmservo.config.new_folder import make_dated_path
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
    tuning, console = read_tuning(options), open_console()
    folder = options.out or make_dated_path("tune")
    require_other_folder(options.file, folder)
    initial, search_folder = tuning.plan.methods[0], folder / SEARCH_FOLDER
    _print_search(console, tuning, folder, search_folder)
    with print_resume_hint(folder, console):
        to_compile = StudyExecution(tuning.validation_plan, folder)
        with open_workers(to_compile, options, console) as workers:
            with show_progress(console, "searching", tuning.trials) as advance:
                trials = run_search(tuning, search_folder, workers, lambda _: advance(1))
            best_trial = find_best_trial(trials)
            found = replace_settings(initial, tuning.method_name, best_trial.values)
            plan = replace(tuning.validation_plan, methods=(initial, found))
            test = StudyExecution(plan, folder)
            print_work(console, test)
            done_count, task_name = plan.runs - test.missing_runs, "testing on unseen scenes"
            with show_progress(console, task_name, plan.runs, done_count, "runs") as advance:
                test.run(workers, advance)
        rows = test.gather()
        write_atomically(folder / TUNED_FILE, format_settings(found, test.user_estimators, tuning))
        summary = _summarise_search(tuning, found, trials, folder / TUNED_FILE)
        header = make_report_header(test) | summary
        written = report.write_report(folder, test.plan, rows, header, page=True)
    is_better = best_trial.number > 0
    none_found = "no settings better than the initial ones were found"
    console.print(summary["found"] if is_better else none_found)
    console.print("on scenes outside the search:")
    print_results(console, written.summaries, written.comparisons)
    console.print(f"settings in {folder / TUNED_FILE}, report in {folder}", soft_wrap=True)
    console.print(f"to use them: {format_run_command(found)}", soft_wrap=True)
    return 0


def read_tuning(options: TuneOptions) -> "Tuning":
    """Return the search that a file describes."""
    from rcmservo.study.plan.file import make_plan, read_study_file
    from rcmservo.study.tuning.search import TuneSection, Tuning
    from rcmservo.study.tuning.space import parse_axis

    study_file = read_study_file(options.file)
    names = options.user_estimator
    with name_origin_in_errors(options.file):
        section = decode_settings(TuneSection, study_file.tune, "tune")
        user_estimators = {name: import_estimator(name, "--user-estimator") for name in names}
        plan = make_plan(study_file, user_estimators)
        method, search = plan.methods[0], study_file.search.items()
        axes = tuple(parse_axis(name, description, method) for name, description in search)
        return Tuning(plan=plan, axes=axes, **asdict(section))


def _print_search(console: Console, tuning: "Tuning", folder: Path, search_folder: Path) -> None:
    """Print the size of the search, and whether it resumes.

    Each trial has its own method, so a change of the method does not count.
    """
    from rcmservo.study.execution import manifest

    size = f"{tuning.trials} trials of {tuning.plan.runs} simulated runs, into {folder}"
    console.print(size, style="dim", soft_wrap=True)
    previous = manifest.read_manifest(search_folder)
    if previous is None:
        return
    changed = manifest.list_changed_settings(previous, manifest.make_manifest(tuning.plan))
    differences = ", ".join(name for name in changed if name != manifest.METHOD_SETTING_NAME)
    reason = f"{differences} changed since the last use of this folder"
    repeats = (
        f"{reason}: trials are repeated" if differences else "existing trials are not repeated"
    )
    console.print(repeats, soft_wrap=True)


def _summarise_search(
    tuning: "Tuning", found: "StudyMethod", trials: "list[SearchTrial]", settings: Path
) -> dict[str, str]:
    """Return the entries of a report on the search."""
    from rcmservo.study.tuning.space import get_setting

    plan, initial = tuning.plan, tuning.plan.methods[0]
    first_cost, best_cost = trials[0].cost, min(trial.cost for trial in trials)
    seeds = f"seeds {plan.first_seed} to {plan.first_seed + plan.count - 1}"
    changes: list[str] = []
    for axis in tuning.axes:
        old, new = (_format_value(get_setting(method, axis.name)) for method in (initial, found))
        changes.append(f"{axis.name} {old} -> {new}")
    return {
        "search": f"{len(trials)} trials of {plan.runs} runs, {seeds}; goal {tuning.goal}, "
        f"initial and best value: {first_cost:.3f}, {best_cost:.3f}",
        "found": ", ".join(changes),
        "settings": str(settings),
    }


def _format_value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def format_run_command(method: "StudyMethod") -> str:
    """Return the `rcmservo run` command with these settings."""
    arguments = ["rcmservo", "run", "--estimator", find_class_name(method.estimator, ESTIMATORS)]
    for settings in method.parts.values():
        settings_class = cast(type[Any], type(settings))
        group, defaults = find_option_group(settings_class, RunOptions), settings_class()
        for f in fields(settings_class):
            value = getattr(settings, f.name)
            if value != getattr(defaults, f.name):
                arguments += _format_option(
                    group.replace("_", "-"), f.name.replace("_", "-"), value
                )
    return shlex.join(arguments)


def _format_option(group: str, name: str, value: Any) -> list[str]:
    """Return a setting as arguments of a command line."""
    if isinstance(value, bool):
        return [f"--{group}.{name}" if value else f"--{group}.no-{name}"]
    values = cast(tuple[Any, ...], value) if isinstance(value, tuple) else (value,)
    return [f"--{group}.{name}", *map(str, values)]


def format_settings(
    method: "StudyMethod", user_estimators: "UserEstimators", tuning: "Tuning"
) -> str:
    """Return the method with all its settings as a file that `rcmservo study` reads."""
    names = {estimator_class: name for name, estimator_class in user_estimators.items()}
    lines = [f"# Found by rcmservo tune: {tuning.trials} trials, goal {tuning.goal}."]
    for part, settings in method.parts.items():
        settings_class = cast(type[Any], type(settings))
        class_name = names.get(settings_class) or find_class_name(settings, PART_CLASSES[part])
        values = {f.name: getattr(settings, f.name) for f in fields(settings_class)}
        # numbers, strings, lists, true and false have the same form in JSON and TOML
        lines.append(f"[method.{method.name}.{part}]")
        lines += [f"{key} = {json.dumps(v)}" for key, v in {"kind": class_name, **values}.items()]
    return "\n".join(lines) + "\n"
