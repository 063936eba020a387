"""Comparison of estimators and servos in the same simulated scenes: `compare`.

The first scene runs in this process, where it compiles; the others run in forked processes. A fork
needs no pickled copy of a method, so that an estimator that is defined in a script or notebook runs
like any other.
"""

import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from operator import index
from typing import Any

from rich.console import Console
from rich.progress import track

from rcmservo.config.class_registry import ESTIMATORS, PRESETS
from rcmservo.constraints import between
from rcmservo.errors import BadInput, require, suggest_name
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import check_estimator
from rcmservo.sim import RigSettings
from rcmservo.study.comparison import ComparedMethod, MethodComparison
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.plan.cell import choose_engine
from rcmservo.study.plan.conditions import COMPILED, DURATION_LIMIT, MAX_RUNS, SEED_LIMIT
from rcmservo.study.plan.method import StudyMethod
from rcmservo.study.plan.plan import CHUNK_SIZES
from rcmservo.study.row import StudyRow
from rcmservo.study.simulation_engine import SimulationEngine

Method = Estimator | Servo | str
"""Method to compare: an estimator, a servo, or the name of a built-in estimator."""

SceneRows = tuple[StudyRow, ...]
"""Rows of all methods in one scene."""

DEFAULT_SCENES = "random"
"""Name in the rows of the scenes of the default settings, as `rcmservo study` names them."""
OTHER_SCENES = "settings"
"""Name in the rows of the scenes of other settings."""

WORKERS_LIMIT = between(1, 4096, "a whole number")


def compare(
    methods: Mapping[str, Method],
    scenes: int | Iterable[int] = 200,
    settings: RigSettings | None = None,
    duration: float = 15.0,
    workers: int | None = None,
) -> MethodComparison:
    """Compare methods in the same simulated scenes with the same noise.

    All methods run on the same engine: on the compiled plant if all of them have a compiled step
    (`DltEstimator`, `ProjectionEstimator`), otherwise on the full simulator with the code of the
    live loop, about half a second of processor time per run. Ctrl-C ends the comparison early: the
    result then has the scenes that are complete.

    Parameters
    ----------
    methods : Mapping[str, Estimator or Servo or str]
        Methods by name: an estimator, built-in or your own; a servo; or the name of a built-in
        estimator, such as "projection". The others are compared with the first.
    scenes : int or Iterable[int]
        Number of scenes, whose seeds count from 0; or their seeds, without repetition. The scene of
        a seed is that of ``rs.sim.Rig(seed, settings, pictures=False)``: its camera reports points
        with ``settings.point_noise``, 0.3 px by default, not images.
    settings : RigSettings or None
        Simulated laboratory; None for the default one, ``rs.sim.RigSettings()``.
    duration : float
        Length of each run, above 1 s and at most 3600 s.
    workers : int or None
        Number of processes; None for one per processor. With 1, all runs are in this process.

    Returns
    -------
    MethodComparison
        Rows, statistics with 95 % confidence intervals, figures, and the worst runs.

    Raises
    ------
    BadInput
        If a parameter is invalid, or a servo has another mechanism or tool than the laboratory.
    UnusableEstimator
        If an estimator fails on made-up samples; the class is in `rcmservo.servo.user_estimator`.

    Notes
    -----
    The same seeds give the same rows, also with `rcmservo study`, whatever the number of workers.
    A run succeeds if its true error, rms over the last second, is at most 1 mm; it need not settle
    as a run of `rcmservo.run` must. Noise and target of a run are drawn from its seed in another
    way than there, so that errors differ by chance.
    """
    seeds = _list_seeds(scenes)
    DURATION_LIMIT.require("duration", duration)
    count = (os.cpu_count() or 1) if workers is None else workers
    WORKERS_LIMIT.require("workers", count)
    compared = _prepare_methods(methods, settings, duration)
    complete = _run_scenes(compared, seeds, count)
    rows = tuple(row for rows in zip(*complete, strict=True) for row in rows)
    return MethodComparison(compared, rows, len(seeds))


def _list_seeds(scenes: Any) -> list[int]:
    """Return the seeds of a number of scenes, or the given seeds."""
    expected = f"a number of scenes from 1 to {MAX_RUNS}, or different seeds such as range(10, 60)"
    try:
        is_list = hasattr(scenes, "__iter__")
        seeds = [index(seed) for seed in scenes] if is_list else range(index(scenes))
    except TypeError as error:
        raise BadInput("scenes", scenes, expected) from error
    is_valid = not isinstance(scenes, bool) and 1 <= len(seeds) <= MAX_RUNS
    require(is_valid and len(set(seeds)) == len(seeds), "scenes", scenes, expected)
    for seed in (min(seeds), max(seeds)):
        SEED_LIMIT.require("scenes", seed)
    return list(seeds)


def _prepare_methods(methods: Any, settings: Any, duration: float) -> tuple[ComparedMethod, ...]:
    """Return the methods with the engine that runs all of them."""
    expected = 'a mapping of names to estimators or servos, such as {"mine": MyEstimator()}'
    is_mapping = hasattr(methods, "items")
    require(is_mapping and len(methods) > 0, "methods", methods, expected)
    expected = "None or the settings of a simulated laboratory, rs.sim.RigSettings(...)"
    require(settings is None or isinstance(settings, RigSettings), "settings", settings, expected)
    lab: RigSettings = RigSettings() if settings is None else settings
    servos: dict[str, Servo] = {}
    for name, method in dict[Any, Any](methods).items():
        is_name = isinstance(name, str) and bool(name.strip())
        require(is_name, "name of a method", name, "a text that is not empty")
        servos[name] = _make_servo(name, method, lab)
    engine = choose_engine(servos.values())
    kind = CompiledEngine if engine == COMPILED else SimulationEngine
    scenes = DEFAULT_SCENES if lab == RigSettings() else OTHER_SCENES
    return tuple(
        ComparedMethod(
            name, kind(servo, lab, duration), engine, _hash_source(servo.estimator), scenes
        )
        for name, servo in servos.items()
    )


def _make_servo(name: str, method: object, lab: RigSettings) -> Servo:
    """Return the servo of a method in a laboratory; raise an error if it cannot run there."""
    field = f"methods[{name!r}]"
    if isinstance(method, str):
        method = _find_built_in(field, method)
    if isinstance(method, Estimator):
        method = Servo(lab.mechanism, lab.tool, method)
    if not isinstance(method, Servo):
        hint = "; call the class, with () after its name" if isinstance(method, type) else ""
        expected = f"an estimator, a servo or the name of a built-in estimator{hint}"
        raise BadInput(field, method, expected)
    for part in ("mechanism", "tool"):
        known, simulated = getattr(method, part), getattr(lab, part)
        expected = f"equal to that of the simulated laboratory, {simulated}"
        require(known == simulated, f"{field}.{part}", known, expected)
    check_estimator(method.estimator, lab.tool)
    return method


def _find_built_in(field: str, name: str) -> Estimator:
    """Return the built-in estimator with a name, with its default settings."""
    names = *ESTIMATORS, *PRESETS
    expected = f"one of {', '.join(names)}{suggest_name(name, names)}"
    require(name in names, field, name, expected)
    return PRESETS[name] if name in PRESETS else ESTIMATORS[name]()


def _hash_source(estimator: Estimator) -> str:
    """Return the SHA-256 of a user's module as `rcmservo study` does; empty without a file."""
    module = sys.modules.get(type(estimator).__module__.partition(".")[0])
    has_file = bool(getattr(module, "__file__", None) or getattr(module, "__path__", None))
    return StudyMethod("", {"estimator": estimator}).archive.digest if has_file else ""


def _run_scenes(
    methods: tuple[ComparedMethod, ...], seeds: list[int], workers: int
) -> list[SceneRows]:
    """Run all scenes and return those that are complete, in order; Ctrl-C ends the runs early."""
    console = Console(stderr=True)
    complete: list[SceneRows] = []
    try:
        with console.status("first scene: the first use on a computer compiles for a minute"):
            complete.append(_run_scene(methods, seeds[0]))
        with _open_workers(methods, min(workers, len(seeds) - 1)) as run_all:
            scenes, others = run_all(seeds[1:]), len(seeds) - 1
            is_hidden = not console.is_terminal
            for rows in track(
                scenes, "comparing", others, console=console, transient=True, disable=is_hidden
            ):
                complete.append(rows)
    except KeyboardInterrupt:
        if not complete:
            raise
    return complete


def _run_scene(methods: tuple[ComparedMethod, ...], seed: int) -> SceneRows:
    """Run all methods in the scene of a seed."""
    return tuple(method.make_row(seed) for method in methods)


@contextmanager
def _open_workers(
    methods: tuple[ComparedMethod, ...], count: int
) -> Generator[Callable[[list[int]], Iterator[SceneRows]]]:
    """Yield a function that runs the scenes of seeds, in order, in a number of processes."""
    if count <= 1:
        yield partial(map, partial(_run_scene, methods))
        return
    executor = ProcessPoolExecutor(count, get_context("fork"), _start_worker, (methods,))
    chunk_size = max(CHUNK_SIZES[methods[0].engine] // len(methods), 1)
    try:
        yield partial(executor.map, _run_worker_scene, chunksize=chunk_size)
    finally:
        executor.shutdown(cancel_futures=True)


_worker_methods: list[ComparedMethod] = []
"""Methods that this process runs as a worker."""


def _start_worker(methods: tuple[ComparedMethod, ...]) -> None:
    """Store the methods, and ignore Ctrl-C, which the parent process handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker_methods[:] = methods


def _run_worker_scene(seed: int) -> SceneRows:
    return _run_scene(tuple(_worker_methods), seed)
