"""Shared fixtures and helpers: random cameras and poses, runs with a point camera, comparisons."""

import gc
import importlib
import os
import pkgutil
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st

import rcmservo.geometry
import rcmservo.safety
import rcmservo.servo
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.correntropy import CorrentropyEstimator
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.estimation.projection_rule import (
    ProjectionEstimator,
    build_normal_equations,
    collect_fitted_points,
)
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.figures import charts
from rcmservo.geometry.kinematics import PITCH_YAW, SPHERICAL, RcmStruct
from rcmservo.geometry.tool import RIGID, RigidTool, ScaledTool, ToolStruct, compute_second_marker
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.loop.teach import teach
from rcmservo.numerics import small_linalg
from rcmservo.numerics.structs import Row
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.servo.servo import Servo
from rcmservo.servo.state import State
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.tracking import PointMarkers

pytest_plugins = ["peers"]


def pytest_collection_finish() -> None:
    """Collect garbage rarely, and not among modules and tests: it took a tenth of the time."""
    gc.freeze()
    gc.set_threshold(20_000)


settings.register_profile("quick", deadline=None, max_examples=10)
settings.register_profile("thorough", deadline=None, max_examples=25, derandomize=True)
settings.load_profile("quick")

ROOT = Path(__file__).resolve().parents[1]

INTERRUPTIBLE_COMMAND = """
import signal, sys
from rcmservo.__main__ import main
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
sys.exit(main())
"""
"""Program of the command line that reacts to Ctrl-C and to a closed terminal, even where a script
runs the tests in the background with both signals ignored."""

ARM_RECORDING = ROOT.parent / "shared/data/dvrk_two_balls"
"""Recording of a real arm, which is not part of this repository."""

SPACING_MM = 30.0
"""Marker spacing of the rigid tool, mm."""

SHAFT = ToolStruct(RIGID, SPACING_MM)
NO_JOINT_LIMITS = (-1e3, -1e3, -1e6), (1e3, 1e3, 1e6)
"""Joint limits that no test reaches."""

SMALL_RIG_TOML = """\
[camera]
width = 320
height = 240
[scene]
focal = [300.0, 400.0]
"""
"""Rig file with small images, which render faster, for tests that do not depend on their size."""

SMALL_30_HZ_RIG_TOML = SMALL_RIG_TOML.replace("[scene]", "frame_rate = 30.0\n[scene]")
"""Rig file with small images at half the usual rate, for tests in wall time: they draw and render
on the processors that also servo."""

seeds = st.integers(0, 2**32 - 1)
kinds = st.sampled_from([SPHERICAL, PITCH_YAW])


def make_rcm(kind: int, zero: float = 0.0) -> RcmStruct:
    """Return the struct of a mechanism without joint limits."""
    return RcmStruct(kind, float(zero), *NO_JOINT_LIMITS)


def mark_others_slow(values: Iterable[Any]) -> list[Any]:
    """Return test parameters: `make test` takes the first and `make test-all` the others."""
    first, *others = values
    return [first, *(pytest.param(value, marks=pytest.mark.slow) for value in others)]


def find_compiled_functions() -> dict[str, Any]:
    """Return every compiled function of the modules that decide a motion, by module and name."""
    packages = [rcmservo.geometry, rcmservo.safety, rcmservo.servo]
    modules = [
        importlib.import_module(module.name)
        for package in packages
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    ]
    return {
        f"{module.__name__}.{name}": value
        for module in [small_linalg, *modules]
        for name, value in vars(module).items()
        if hasattr(value, "py_func") and value.__module__ == module.__name__
    }


def make_tick_facts(**parts: Any) -> TickFacts:
    """Return `TickFacts` with the given parts; all others are None."""
    facts: Any = dict.fromkeys(TickFacts._fields) | parts
    rows = {name: part.rows[0] for name, part in facts.items() if isinstance(part, Row)}
    return TickFacts(**facts | rows)


def make_environment(**variables: str) -> dict[str, str]:
    """Return the environment of a process that can import the modules of the tests."""
    tests = ROOT / "tests"
    folders = [tests, *(path for path in tests.iterdir() if path.is_dir())]
    paths = [*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths)} | variables


def wait_until(reached: Callable[[], bool], process: subprocess.Popen[Any]) -> None:
    """Wait until `reached` is true, or until the process that should make it true ends."""
    while not reached() and process.poll() is None:
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.02)


def make_random(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def differentiate(f: Callable[[Floats], Any], x: Floats, step: Any) -> Floats:
    """Return ∂f/∂x by central differences of fourth order, with one step or one per coordinate."""
    steps = np.broadcast_to(np.asarray(step, dtype=float), x.shape)
    columns = []
    for i in range(len(x)):
        offset = np.zeros(len(x))
        offset[i] = steps[i]
        near = np.asarray(f(x + offset)) - np.asarray(f(x - offset))
        far = np.asarray(f(x + 2 * offset)) - np.asarray(f(x - 2 * offset))
        columns.append((8 * near - far) / (12 * steps[i]))
    return np.stack(columns, axis=-1)


def draw_tool_positions(random: np.random.Generator, count: int, spread: float = 25.0) -> Floats:
    """Return random positions p₁ (count, 3) mm in a cube that is far from the RCM."""
    direction = random.standard_normal(3)
    middle = random.uniform(80.0, 150.0) * direction / np.linalg.norm(direction)
    return middle + random.uniform(-spread, spread, (count, 3))


def draw_calibration_matrix(random: np.random.Generator, places: Floats) -> Floats:
    """Return a random calibration matrix C (3, 4) of random scale.

    All `places` (n, 3) mm of marker 1, those of marker 2 and the RCM are in front of the camera.
    """
    middle = places.mean(axis=0)
    tips = np.stack([compute_second_marker(SHAFT, p) for p in places])
    while True:
        forward = random.standard_normal(3)
        forward /= np.linalg.norm(forward)
        rotation = np.linalg.qr(np.column_stack([forward, random.standard_normal((3, 2))]))[0].T[
            [1, 2, 0]
        ]
        rotation *= np.sign(rotation[2] @ forward)
        position = middle - random.uniform(150.0, 350.0) * forward
        focal = random.uniform(500.0, 900.0)
        K = np.array(
            [
                [focal, 0.0, random.uniform(300, 340)],
                [0.0, focal, random.uniform(220, 260)],
                [0.0, 0.0, 1.0],
            ]
        )
        depths = (np.concatenate([places, tips, np.zeros((1, 3))]) - position) @ rotation[2]
        m1, m2 = ((p - position) @ rotation.T for p in (places, tips))
        distances = np.linalg.norm(m1[:, :2] / m1[:, 2:] - m2[:, :2] / m2[:, 2:], axis=1) * focal
        if depths.min() > 60.0 and distances.min() > 15.0:
            scale = random.choice([-1.0, 1.0]) * np.exp(random.uniform(-5.0, 5.0))
            return scale * K @ np.column_stack([rotation, -rotation @ position])


def project_points(C: Floats, p: Floats) -> Floats:
    """Return the pixels (n, 2) of points p (n, 3) mm: eq. (4), written a second time."""
    image = np.column_stack([p, np.ones(len(p))]) @ C.T
    return image[:, :2] / image[:, 2:]


def project_markers(C: Floats, p1: Floats) -> Floats:
    """Return the raw pixels (2, 2) of both markers of the rigid tool for p₁ (3,) mm."""
    return project_points(C, np.stack([p1, compute_second_marker(SHAFT, p1)]))


def make_observation_rows(C: Floats, places: Floats) -> Floats:
    """Return the projection estimator's rows [p₁, raw m₁ m₂] (n, 7) without noise."""
    return np.stack([np.concatenate([p, project_markers(C, p).ravel()]) for p in places])


def build_equations(rows: Floats, o_c: Floats, both: bool = True) -> tuple[Floats, Floats]:
    return build_normal_equations(collect_fitted_points(rows, len(rows), o_c, both, SHAFT))


ESTIMATORS = {
    "fast": ProjectionEstimator(),
    "printed": ProjectionEstimator(gamma="printed", estimator_time=1000.0),
    "dlt": DltEstimator(),
    "flow": FlowEstimator(gamma=0.05),
    "broyden": BroydenEstimator(min_step=0.1),
    "nflow": NormalisedFlowEstimator(min_step=0.1),
    "rls": RlsEstimator(min_step=0.1),
    "kalman": KalmanEstimator(min_step=0.1),
    "correntropy": CorrentropyEstimator(min_step=0.1),
}
TOOLS = {"rigid": RigidTool(spacing=SPACING_MM), "scaled": ScaledTool(scale=1.3)}
CONTROLLERS = {
    "continuous": SaturatedController(),
    "printed": SaturatedController(potential="printed"),
}


@dataclass
class Laboratory:
    """Simulated rig with a camera that delivers points, and a taught target.

    Parameters
    ----------
    rig : Rig
        Simulated rig.
    plant : Plant
        Plant of the rig's arm, camera and clock.
    target : Target
        Target that the rig taught.
    """

    rig: Rig
    plant: Plant
    target: Target

    def servo(self, **choices: Any) -> Servo:
        return Servo(self.rig.settings.mechanism, **({"tool": self.rig.settings.tool} | choices))

    def run(
        self,
        servo: Servo,
        seconds: float,
        state: State | None = None,
        change: Callable[[Observation], Observation] = lambda observation: observation,
    ) -> Iterator[tuple[Observation, State]]:
        """Yield observation and state of every tick of a new run, or of one that continues `state`.

        `change` replaces each observation before the servo gets it.
        """
        if state is None:
            state = servo.init()
            self.plant.reset()
            self.plant.enable()
        else:
            self.plant.clock.wait_until(state.command.time + 10_000_000)
        for _ in ticks(self.plant.clock, 100.0, seconds):
            current = change(self.plant.read())
            state = servo.step(state, current, self.target)
            self.plant.send(state.command)
            yield current, state


def teach_target(rig: Rig, plant: Plant) -> Target:
    """Return the target that the rig teaches; the tool is back at the start afterwards."""
    rig.move_to_target()
    target = teach(plant, frames=5)
    rig.go_home()
    return target


def make_laboratory(
    seed: int = 1, settings: RigSettings | None = None, disturbances: Sequence[Disturbance] = ()
) -> Laboratory:
    rig = Rig(seed, settings, pictures=False, disturbances=disturbances)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    return Laboratory(rig, plant, teach_target(rig, plant))


def make_observation(
    now: int,
    q: Floats,
    frame: int,
    exposure: int,
    q_exposure: Floats,
    points: Floats,
    **others: Any,
) -> Observation:
    """Return an observation of an arm that follows, with a frame that arrives at its exposure."""
    return Observation(
        now, q, now, True, np.zeros(3), frame, exposure, exposure, q_exposure, points, **others
    )


def lose_markers(current: Observation, *markers: int) -> Observation:
    """Return the observation with some markers (0 or 1) lost."""
    points = current.points.copy()
    points[list(markers)] = np.nan
    return replace(current, points=points)


def list_leaves(value: Any) -> list[Any]:
    """Return all numbers, arrays and names of a record, in order."""
    if isinstance(value, Row):
        return [value.rows]
    if is_dataclass(value) and not isinstance(value, type):
        return [leaf for f in fields(value) for leaf in list_leaves(getattr(value, f.name))]
    if isinstance(value, tuple | list):
        return [leaf for part in value for leaf in list_leaves(part)]
    return [value]


def snapshot(value: Any) -> list[Any]:
    """Return the values of a record bit by bit, equal for two records only if nothing differs."""
    exact = []
    for leaf in list_leaves(value):
        if isinstance(leaf, np.ndarray):
            exact.append((leaf.dtype.str, leaf.shape, leaf.tobytes()))
        elif isinstance(leaf, float):
            exact.append(np.float64(leaf).tobytes())
        else:
            exact.append(leaf)
    return exact


@pytest.fixture
def lab() -> Laboratory:
    return make_laboratory()


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save empty figures, for tests that do not examine them: drawing one takes 0.3 s."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(charts, "draw_figure", lambda figure: Figure(figsize=(1.0, 1.0)))
