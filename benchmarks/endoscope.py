"""Closed loops with an endoscope: the camera enters through its own port, next to that of the tool.

    python benchmarks/endoscope.py --scenes 200 --hidden 2

The RCM may lie behind the camera, at its side or in front of it. The ports are 70-130 mm apart, the
camera 60-120 mm from the tool, the markers 15 mm apart; the target is taught for 5 s, and the servo
runs for 15 s. The runs use the compiled simulation with a camera of points, or rendered images. One
marker may disappear permanently when the servo starts.

Ports have any direction here, also below the tool, and the balls may overlap partly, because the
question is the position of the RCM. `SceneSettings.ports` places them in a patient's abdominal
wall.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import Pool
from typing import Literal

import numpy as np
import tyro

import rcmservo as rs
from rcmservo.cli.servo_options import ServoOptions
from rcmservo.interfaces import Floats
from rcmservo.loop.teach import TeachingFailed
from rcmservo.loop.tick import Tick
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.sim import Disturbance
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.scene import Scene
from rcmservo.sim.tool_body import ToolBody
from rcmservo.study import StudyRun
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.kernel_engine import StudyGoal
from rcmservo.study.report import statistics

TEACHING_FRAMES = 300
"""Frames of a taught target: 5 s."""
DURATION = 15.0
"""Duration (s) of a run."""
BORDER = 20.0
"""Smallest distance (px) of the markers from the border of the image and from each other."""
CLEARANCE = 15.0
"""Distance (mm) from the tool to the tissue behind it."""
NEAR_PLANE = 0.3
"""Largest |depth| of the RCM relative to that of the tool that counts as near the image plane."""
OPTICS = rs.sim.Rig(0, pictures=False).scene.optics


def ends(random: np.random.Generator, body: ToolBody) -> Floats:
    """Return the joints (2, 3) of a random start and of a target nearby."""
    limits = body.mechanism.limits
    start = random.uniform(limits.lower, limits.upper)
    start[2] = random.uniform(70.0, 150.0)
    return np.stack([start, start + random.uniform(-1.0, 1.0, 3) * np.array([0.15, 0.15, 15.0])])


def camera(random: np.random.Generator, middle: Floats) -> CameraModel:
    """Return a random endoscope that looks at `middle` (3,) in mm through its port."""
    direction = random.standard_normal(3)
    port = random.uniform(70.0, 130.0) * direction / np.linalg.norm(direction)
    axis = (middle - port) / np.linalg.norm(middle - port)
    position = middle - random.uniform(60.0, 120.0) * axis
    rotation = compute_look_at_rotation(position, middle, random.uniform(-np.pi, np.pi))
    focal = random.uniform(500.0, 800.0)
    return replace(OPTICS, focal=focal, position=position, rotation=rotation)


def draw(seed: int, body: ToolBody) -> Scene:
    """Return the first random scene with both markers visible and separate at start and target."""
    random, size = np.random.default_rng([seed, 77]), np.array([OPTICS.width, OPTICS.height])
    lower, upper = body.mechanism.limits.arrays
    while True:
        path = ends(random, body)
        markers = np.concatenate([body.points(q)[:2] for q in path])
        optics = camera(random, markers.mean(axis=0))
        pixels = optics.project(markers)
        inside = (pixels > BORDER).all() and (pixels < size - BORDER).all()
        apart = np.linalg.norm(pixels[0] - pixels[1]) > BORDER
        far = np.linalg.norm(markers[0] - markers[2]) > 8.0
        if inside and apart and far and (path[1] > lower).all() and (path[1] < upper).all():
            return Scene(optics, body, path, path[0], behind(optics, body, path), 0)


def behind(optics: CameraModel, body: ToolBody, path: Floats) -> Tissue:
    """Return tissue across the view, behind the whole tool at the joints `path` (2, 3)."""
    axis = optics.rotation[2]
    tool = np.concatenate([body.points(q) for q in path])
    return Tissue(axis * (np.max(tool @ axis) + CLEARANCE), axis)


def depth(scene: Scene) -> float:
    """Return the depth of the RCM relative to that of the tool."""
    tool = scene.body.points(scene.start)[:1]
    return float(scene.optics.depth(np.zeros((1, 3)))[0] / scene.optics.depth(tool)[0])


@dataclass(frozen=True)
class Options:
    """Options of the benchmark."""

    scenes: int = 200
    """Number of scenes, with seeds from 0 on."""
    noise: float = 0.3
    """Noise (px) of the camera of points."""
    estimator: str = "dlt"
    """Name of the estimator."""
    hidden: Literal[0, 1, 2] = 0
    """Marker that disappears at the first tick of SERVO; 0 for none."""
    pictures: bool = False
    """Use rendered images."""


@dataclass(frozen=True)
class Ended:
    """Result of one closed loop."""

    depth: float
    """Depth of the RCM relative to that of the tool."""
    final: float
    """Final pose error (mm)."""
    first: float
    """Time (s) until first within 1 mm."""
    stops: tuple[str, ...]
    """Causes of the stops."""


def ended(scene: Scene, run: StudyRun) -> Ended:
    causes = tuple(cause.name for _, cause in run.stops)
    return Ended(depth(scene), float(run.error[-1]), run.first_within(1.0), causes)


def settings_of(options: Options) -> rs.sim.RigSettings:
    return rs.sim.RigSettings(point_noise=options.noise, tool=rs.RigidTool(spacing=15.0))


def by_twin(options: Options, seed: int) -> Ended:
    """Run one closed loop on the compiled simulation."""
    settings = settings_of(options)
    estimator = ServoOptions().find_estimator(options.estimator)
    study = CompiledEngine(
        rs.Servo(settings.mechanism, settings.tool, estimator), settings, teaching_frames=30
    )
    scene = draw(seed, ToolBody(settings.mechanism, settings.tool))
    random, markers = np.random.default_rng(seed), scene.body.points(scene.target)[:2]
    blur = random.standard_normal((2, 2)) / np.sqrt(TEACHING_FRAMES)
    points = scene.optics.project(markers) + options.noise * blur
    noise = options.noise * random.standard_normal((1000, 2, 2))
    goal = StudyGoal(points, scene.target, markers[1])
    run = study.of(seed, scene, goal, noise)
    servoing = np.flatnonzero(run.phases == PHASES.index(Phase.SERVO))
    if options.hidden and len(servoing):
        begun = servoing[0] / run.rate * settings.timing.frame_rate
        noise[round(begun) :, options.hidden - 1] = np.nan
        run = study.of(seed, scene, goal, noise)
    return ended(scene, run)


def by_laboratory(options: Options, seed: int) -> Ended:
    """Run one closed loop with rendered images."""
    scene = draw(seed, ToolBody(rs.SphericalRcm(), settings_of(options).tool))
    try:
        return run_laboratory(options, seed, scene)
    except TeachingFailed:
        return Ended(depth(scene), np.inf, np.inf, ("NOT_SHOWN",))


def run_laboratory(options: Options, seed: int, scene: Scene) -> Ended:
    """Run one closed loop with rendered images, perhaps with a hidden marker."""
    if not options.hidden:
        return ended(scene, course(seed, scene, ticks(options, seed, scene, [])))
    servoing = (t for t in ticks(options, seed, scene, []) if t.state.phase is Phase.SERVO)
    at = next((tick.time for tick in servoing), 0) * 1e-9
    lost = Disturbance.parse(f"occlusion:at={at},marker={options.hidden}")
    return ended(scene, course(seed, scene, ticks(options, seed, scene, [lost])))


def ticks(
    options: Options, seed: int, scene: Scene, disturbances: list[Disturbance]
) -> Iterator[Tick]:
    """Teach the target, return the tool to the start, and yield the ticks of the run."""
    rig = rs.sim.Rig(seed, settings_of(options), disturbances=disturbances, scene=scene)
    plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)
    rig.move_to_target()
    target = rs.teach(plant, TEACHING_FRAMES)
    rig.go_home()
    rig.begin()
    settings, estimator = rig.settings, ServoOptions().find_estimator(options.estimator)
    servo = rs.Servo(settings.mechanism, settings.tool, estimator)
    yield from rs.servo_ticks(plant, servo, target, DURATION)


def course(seed: int, scene: Scene, ticks: Iterator[Tick]) -> StudyRun:
    """Return a run in the form of a study, with errors from the reported joints."""
    run, there = list(ticks), scene.body.points(scene.target)[1]
    distances = [np.linalg.norm(scene.body.points(tick.observation.q)[1] - there) for tick in run]
    phases = np.array([PHASES.index(tick.state.phase) for tick in run], np.int8)
    causes = np.array([tick.state.cause.code for tick in run], np.int8)
    errors, rate = np.array(distances, np.float64), run[0].servo.rate
    return StudyRun(seed, rate, errors, phases, causes, np.nan, scene)


def share(count: int, of: int) -> str:
    """Return a percentage with its confidence interval, as text."""
    value, low, high = statistics.estimate_fraction(count, of)
    return f"{100 * value:.2f} % ({100 * low:.2f}-{100 * high:.2f})"


def report(options: Options, runs: list[Ended]) -> None:
    count, final = len(runs), np.array([run.final for run in runs])
    where, first = np.array([run.depth for run in runs]), [run.first for run in runs]
    print(f"RCM behind the camera        {(where < 0.0).mean():.0%}")
    print(f"near its image plane         {(abs(where) < NEAR_PLANE).mean():.0%}")
    print(f"within 1 mm at the end       {share(int((final <= 1.0).sum()), count)}")
    print(f"first within 1 mm            median {np.median(first):.2f} s")
    print(f"error at the end             median {np.median(final):.3f} mm, worst {final.max():.1f}")
    print(
        f"first stops                  {dict(Counter(run.stops[0] for run in runs if run.stops))}"
    )
    for seed, run in enumerate(runs):
        if not run.final <= 1.0:
            print(
                f"  seed {seed}: error {run.final:.1f} mm, RCM depth {run.depth:.2f}, {run.stops}"
            )


def main(options: Options) -> None:
    one: Callable[[int], Ended] = partial(by_laboratory if options.pictures else by_twin, options)
    print(options)
    one(0)  # compile once, not in each process
    runs: list[Ended] = []
    with Pool() as pool:
        for run in pool.imap(one, range(options.scenes)):
            runs.append(run)
            print(f"\r{len(runs)} of {options.scenes}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    report(options, runs)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
