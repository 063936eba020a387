"""Closed loops as an endoscope sees them: the camera comes through a port of its own, beside that
of the tool, so that the RCM lies behind it, beside it or before it.

    python benchmarks/endoscope.py --scenes 200 --hidden 2

Ports 70-130 mm apart, the camera 60-120 mm from the tool, 15 mm between the markers, the target
shown for 5 s and 15 s of servoing: by the compiled twin of the laboratory with a camera that tells
points, or by the laboratory itself with rendered pictures. One marker may be hidden for good once
the tool is on its way.

Here ports are in any direction, beneath the tool too, and balls may overlap in part: what is asked
is where the RCM may be. `SceneSettings.ports` has them in a patient's wall.
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
from rcmservo.loop.teach import NotShown
from rcmservo.loop.tick import Tick
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.sim import Disturbance
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.scene import Scene
from rcmservo.sim.tool_body import ToolBody
from rcmservo.study import Study, StudyRun
from rcmservo.study.kernel_engine import Goal
from rcmservo.study.report import statistics

SHOWN = 300
"""Frames: 5 s."""
DURATION = 15.0
"""s."""
BORDER = 20.0
"""px that the markers keep from the picture's border."""
CLEARANCE = 15.0
"""mm from the tool to the tissue behind it."""
NEAR_PLANE = 0.3
"""Depth of the RCM, in units of the tool's, up to which it counts as near the image plane."""
OPTICS = rs.sim.Rig(0, pictures=False).scene.optics


def ends(random: np.random.Generator, body: ToolBody) -> Floats:
    """Joints (2, 3) of a start, and of a target near by."""
    limits = body.mechanism.limits
    start = random.uniform(limits.lower, limits.upper)
    start[2] = random.uniform(70.0, 150.0)
    return np.stack([start, start + random.uniform(-1.0, 1.0, 3) * np.array([0.15, 0.15, 15.0])])


def camera(random: np.random.Generator, middle: Floats) -> CameraModel:
    """An endoscope that looks at `middle` (3,) mm through a port of its own."""
    way = random.standard_normal(3)
    port = random.uniform(70.0, 130.0) * way / np.linalg.norm(way)
    sight = (middle - port) / np.linalg.norm(middle - port)
    place = middle - random.uniform(60.0, 120.0) * sight
    rotation = compute_look_at_rotation(place, middle, random.uniform(-np.pi, np.pi))
    return replace(OPTICS, focal=random.uniform(500.0, 800.0), position=place, rotation=rotation)


def draw(seed: int, body: ToolBody) -> Scene:
    """The first scene that shows both markers apart, at the start and at the target."""
    random, size = np.random.default_rng([seed, 77]), np.array([OPTICS.width, OPTICS.height])
    lower, upper = body.mechanism.limits.arrays
    while True:
        way = ends(random, body)
        markers = np.concatenate([body.points(q)[:2] for q in way])
        optics = camera(random, markers.mean(axis=0))
        pixels = optics.project(markers)
        inside = (pixels > BORDER).all() and (pixels < size - BORDER).all()
        apart = np.linalg.norm(pixels[0] - pixels[1]) > BORDER
        far = np.linalg.norm(markers[0] - markers[2]) > 8.0
        if inside and apart and far and (way[1] > lower).all() and (way[1] < upper).all():
            return Scene(optics, body, way, way[0], behind(optics, body, way), 0)


def behind(optics: CameraModel, body: ToolBody, way: Floats) -> Tissue:
    """Tissue across the view, behind all of the tool at the joints `way` (2, 3)."""
    sight = optics.rotation[2]
    tool = np.concatenate([body.points(q) for q in way])
    return Tissue(sight * (np.max(tool @ sight) + CLEARANCE), sight)


def depth(scene: Scene) -> float:
    """Of the RCM, in units of the tool's."""
    tool = scene.body.points(scene.start)[:1]
    return float(scene.optics.depth(np.zeros((1, 3)))[0] / scene.optics.depth(tool)[0])


@dataclass(frozen=True)
class Options:
    """What is tried."""

    scenes: int = 200
    """Seeds 0 to one less."""
    noise: float = 0.3
    """px, of the camera that tells points."""
    estimator: str = "dlt"
    """By its name."""
    hidden: Literal[0, 1, 2] = 0
    """Marker that is lost from the first tick of SERVO on; 0: neither."""
    pictures: bool = False
    """Rendered pictures."""


@dataclass(frozen=True)
class Ended:
    """How one closed loop went."""

    depth: float
    """Of the RCM, in units of the tool's."""
    final: float
    """mm off at the end."""
    first: float
    """s until it was first within 1 mm."""
    stops: tuple[str, ...]
    """Why it stopped."""


def ended(scene: Scene, run: StudyRun) -> Ended:
    causes = tuple(cause.name for _, cause in run.stops)
    return Ended(depth(scene), float(run.error[-1]), run.first_within(1.0), causes)


def settings_of(options: Options) -> rs.sim.RigSettings:
    return rs.sim.RigSettings(point_noise=options.noise, tool=rs.RigidTool(spacing=15.0))


def by_twin(options: Options, seed: int) -> Ended:
    """One closed loop of the twin."""
    settings = settings_of(options)
    estimator = ServoOptions().estimator_of(options.estimator)
    study = Study(rs.Servo(settings.mechanism, settings.tool, estimator), settings, shown=30)
    scene = draw(seed, ToolBody(settings.mechanism, settings.tool))
    random, markers = np.random.default_rng(seed), scene.body.points(scene.target)[:2]
    blur = random.standard_normal((2, 2)) / np.sqrt(SHOWN)
    points = scene.optics.project(markers) + options.noise * blur
    noise = options.noise * random.standard_normal((1000, 2, 2))
    goal = Goal(points, scene.target, markers[1])
    run = study.of(seed, scene, goal, noise)
    servoing = np.flatnonzero(run.phases == PHASES.index(Phase.SERVO))
    if options.hidden and len(servoing):
        begun = servoing[0] / run.rate * settings.timing.frame_rate
        noise[round(begun) :, options.hidden - 1] = np.nan
        run = study.of(seed, scene, goal, noise)
    return ended(scene, run)


def by_laboratory(options: Options, seed: int) -> Ended:
    """One closed loop of the laboratory, with rendered pictures."""
    scene = draw(seed, ToolBody(rs.SphericalRcm(), settings_of(options).tool))
    try:
        return shown(options, seed, scene)
    except NotShown:
        return Ended(depth(scene), np.inf, np.inf, ("NOT_SHOWN",))


def shown(options: Options, seed: int, scene: Scene) -> Ended:
    """The same, of a target that the tracker sees whole."""
    if not options.hidden:
        return ended(scene, course(seed, scene, ticks(options, seed, scene, [])))
    servoing = (t for t in ticks(options, seed, scene, []) if t.state.phase is Phase.SERVO)
    at = next((tick.time for tick in servoing), 0) * 1e-9
    lost = Disturbance.parse(f"occlusion:at={at},marker={options.hidden}")
    return ended(scene, course(seed, scene, ticks(options, seed, scene, [lost])))


def ticks(
    options: Options, seed: int, scene: Scene, disturbances: list[Disturbance]
) -> Iterator[Tick]:
    """A person shows the target and brings the tool home; then the servo runs."""
    rig = rs.sim.Rig(seed, settings_of(options), disturbances=disturbances, scene=scene)
    plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)
    rig.move_to_target()
    target = rs.teach(plant, SHOWN)
    rig.move_to_start()
    rig.begin()
    settings, estimator = rig.settings, ServoOptions().estimator_of(options.estimator)
    servo = rs.Servo(settings.mechanism, settings.tool, estimator)
    yield from rs.run(plant, servo, target, DURATION)


def course(seed: int, scene: Scene, ticks: Iterator[Tick]) -> StudyRun:
    """How a run in a scene went, by the joints that the arm told."""
    run, there = list(ticks), scene.body.points(scene.target)[1]
    away = [np.linalg.norm(scene.body.points(tick.seen.q)[1] - there) for tick in run]
    phases = np.array([PHASES.index(tick.state.phase) for tick in run], np.int8)
    causes = np.array([tick.state.cause.place for tick in run], np.int8)
    errors, rate = np.array(away, np.float64), run[0].servo.rate
    return StudyRun(seed, rate, errors, phases, causes, np.nan, scene)


def share(count: int, of: int) -> str:
    """A share and its interval."""
    value, low, high = statistics.share(count, of)
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
                f"  seed {seed}: {run.final:.1f} mm off, RCM at depth {run.depth:.2f}, {run.stops}"
            )


def main(options: Options) -> None:
    one: Callable[[int], Ended] = partial(by_laboratory if options.pictures else by_twin, options)
    print(options)
    one(0)  # compiled once, not by every process at a time
    runs: list[Ended] = []
    with Pool() as pool:
        for run in pool.imap(one, range(options.scenes)):
            runs.append(run)
            print(f"\r{len(runs)} of {options.scenes}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    report(options, runs)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
