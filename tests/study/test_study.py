"""The compiled twin of the laboratory goes the way of MuJoCo's arm, with the live servo's step."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import first_quick
from rcmservo.errors import BadInput
from rcmservo.guard.causes import Cause
from rcmservo.guard.states import PHASES, Phase
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.kinematics import PitchYawRcm, SphericalRcm
from rcmservo.method.tool import RigidTool, ScaledTool
from rcmservo.servo.servo import Servo
from rcmservo.sim import Drive, Rig, RigSettings
from rcmservo.sim.body import Body
from rcmservo.sim.optics import Optics, look_at
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.rig import drawn
from rcmservo.sim.scene import Scene
from rcmservo.study import Study, StudyRun
from rcmservo.study.closed_loop import Goal
from rcmservo.tracking import PointMarkers

QUIET = RigSettings(point_noise=0.0)
WRIST = RigSettings(mechanism=PitchYawRcm(), tool=ScaledTool(1.3), point_noise=0.0)
NEAR = 0.1
"""mm by which the two may differ while the tool moves: what MuJoCo's inertia delays in 1 ms."""


def study_of(settings: RigSettings, **choices: float) -> Study:
    return Study(Servo(settings.mechanism, settings.tool), settings, **choices)


def by_physics(seed: int, settings: RigSettings, seconds: float) -> tuple[Floats, list[int]]:
    """Error and phase of every tick of the same closed loop with MuJoCo's arm and the live path."""
    rig = Rig(seed, settings, pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo, target = Servo(settings.mechanism, settings.tool), shown(seed, settings)
    aim = Target(target.points, rig.scene.target, rig.clock.now())
    plant.enable()
    state, errors, phases = servo.init(), [], []
    for _ in ticks(plant.clock, 100.0, seconds):
        state = servo.step(state, plant.read(), aim)
        errors.append(np.linalg.norm(rig.body.points(rig.arm.q_true)[1] - target.p2))
        phases.append(PHASES.index(state.phase))
        plant.send(state.command)
    return np.array(errors), phases


def shown(seed: int, settings: RigSettings) -> Goal:
    rig = Rig(seed, settings, pictures=False)
    markers = rig.body.points(rig.scene.target)[:2]
    return Goal(rig.scene.optics.project(markers), rig.scene.target, markers[1])


def by_twin(study: Study, seed: int) -> StudyRun:
    scene, _ = drawn(seed, study.settings)
    return study.of(seed, scene, shown(seed, study.settings), np.zeros((1000, 2, 2)))


@pytest.mark.parametrize(
    "scene",
    first_quick([(WRIST, 1), *((settings, n) for settings in (QUIET, WRIST) for n in range(5))]),
)
def test_the_twin_goes_the_way_of_the_simulated_arm(scene: tuple[RigSettings, int]) -> None:
    settings, seed = scene
    errors, phases = by_physics(seed, settings, 8.0)
    twin = by_twin(study_of(settings, duration=8.0), seed)
    assert np.abs(twin.error - errors).max() < NEAR
    assert np.count_nonzero(twin.phases != phases) <= 2
    assert errors[0] > 10.0 and errors[-1] < 0.5


def test_a_twin_with_other_drives_goes_another_way() -> None:
    slow = replace(QUIET, drive=Drive(lag=0.03))
    usual, other = (by_twin(study_of(one, duration=4.0), 0) for one in (QUIET, slow))
    assert np.abs(usual.error - other.error).max() > NEAR


def test_the_same_seed_is_the_same_run_in_whatever_process() -> None:
    study = study_of(RigSettings(), duration=2.0)
    alone, together = [study.run(seed) for seed in (3, 4)], list(study.runs([3, 4]))
    for one, other in zip(alone, together, strict=True):
        assert one.seed == other.seed and one.error.tobytes() == other.error.tobytes()
    assert alone[0].error.tobytes() != alone[1].error.tobytes()


def test_noise_beyond_what_the_checks_bear_stops_it_and_the_cause_is_told() -> None:
    run = study_of(RigSettings(point_noise=5.0), duration=12.0).run(0)
    assert run.stops and run.stops[0][1] is Cause.NOT_EXPLORED
    assert run.first_within(0.0) == np.inf
    for noise in (0.0, 1.0):
        assert not study_of(RigSettings(point_noise=noise), duration=5.0).run(0).stops


@pytest.mark.slow
def test_averaged_markers_bring_the_tool_nearer_at_the_same_speed() -> None:
    """0.3 px of noise: the markers as they are seen, or without their noise."""
    servos = [
        Servo(SphericalRcm(), RigidTool(30.0), estimator)
        for estimator in (ProjectionEstimator(), DltEstimator())
    ]
    seen, averaged = ([Study(servo, shown=300).run(seed) for seed in range(12)] for servo in servos)
    errors = [np.median([run.error[-300:].mean() for run in runs]) for runs in (seen, averaged)]
    times = [np.median([run.first_within(1.0) for run in runs]) for runs in (seen, averaged)]
    assert errors[1] < 0.7 * errors[0] < 0.3
    assert times[1] < 1.1 * times[0] < 6.0


def behind(optics: Optics, body: Body) -> Scene:
    """A scene as an endoscope sees it: through a port of its own, with the arm's RCM behind it."""
    q = np.array([0.6, 0.3, 120.0])
    start, port = body.points(q)[:2].mean(axis=0), np.array([-80.0, 40.0, 0.0])
    sight = (start - port) / np.linalg.norm(start - port)
    place = start - 80.0 * sight
    endoscope = replace(optics, focal=600.0, position=place, rotation=look_at(place, start))
    assert endoscope.depth(np.zeros((1, 3)))[0] < 0.0
    target = q + np.array([0.08, 0.1, 9.0])
    return Scene(endoscope, body, np.stack([q, target]), q, Tissue(place, sight), 0)


@pytest.mark.parametrize(
    ("estimator", "arrives"), [(DltEstimator(), True), (ProjectionEstimator(), False)]
)
def test_where_the_rcm_is_behind_the_camera_the_whole_projection_servoes(
    estimator: Estimator, arrives: bool
) -> None:
    settings = replace(QUIET, tool=RigidTool(15.0))
    body = Body(settings.mechanism, settings.tool)
    scene = behind(drawn(0, QUIET)[0].optics, body)
    study = Study(Servo(settings.mechanism, settings.tool, estimator), settings)
    markers = body.points(scene.target)[:2]
    goal = Goal(scene.optics.project(markers), scene.target, markers[1])
    run = study.of(0, scene, goal, np.zeros((1000, 2, 2)))
    assert run.error[0] > 10.0 and (run.error[-1] < 0.5) == arrives


def test_what_it_tells_of_a_run_is_counted_from_its_first_tick() -> None:
    phases = [Phase.SERVO, Phase.HOLD, Phase.HOLD, Phase.ACQUIRE, Phase.FAULT]
    places = np.array([PHASES.index(phase) for phase in phases], np.int8)
    causes = np.array([0, Cause.STALE.place, Cause.STALE.place, 0, Cause.DRIVE_OFF.place], np.int8)
    run = StudyRun(
        0, 100.0, np.array([3.0, 2.0, 1.0, 0.5, 1.5]), places, causes, 0.1, drawn(0, QUIET)[0]
    )
    assert run.first_within(1.0) == 0.02
    assert run.stops == [(0.01, Cause.STALE), (0.04, Cause.DRIVE_OFF)]
    held = replace(run, phases=places[1:], causes=causes[1:])
    assert held.stops == [(0.0, Cause.STALE), (0.03, Cause.DRIVE_OFF)]


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"servo": Servo(SphericalRcm(), RigidTool(30.0), FlowEstimator())}, "servo.estimator"),
        ({"duration": np.nan}, "duration must be a positive time"),
        ({"shown": 0}, "shown"),
        ({"servo": Servo(PitchYawRcm(), RigidTool(30.0))}, "servo.mechanism"),
        ({"servo": Servo(SphericalRcm(), RigidTool(29.0))}, "servo.tool"),
        ({"settings": RigSettings(drive=Drive(delay=1.0)), "servo": None}, "drive.delay"),
    ],
)
def test_what_cannot_be_studied_is_one_sentence(choices: dict, words: str) -> None:
    fast = Servo(SphericalRcm(), RigidTool(30.0), rate=200.0)
    if choices.get("servo") is None:
        choices = choices | {"servo": fast}
    with pytest.raises(BadInput, match=words):
        Study(**choices)


def test_a_seed_or_a_noise_that_cannot_be_is_one_sentence() -> None:
    study = study_of(QUIET, duration=1.0)
    with pytest.raises(BadInput, match="seed must be"):
        study.run(-1)
    scene, _ = drawn(0, QUIET)
    with pytest.raises(BadInput, match="noise must be"):
        study.of(0, scene, shown(0, QUIET), np.zeros((10, 2, 2)))
