"""Agreement of the compiled plant with MuJoCo's arm, both with the live servo's step."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import mark_others_slow
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.geometry.kinematics import PitchYawRcm, SphericalRcm
from rcmservo.geometry.tool import RigidTool, ScaledTool
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.servo.servo import Servo
from rcmservo.sim import Drive, Rig, RigSettings
from rcmservo.sim.arm import HARD_STOP_RATIO
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.imperfections import Imperfections
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.sim.scene import Scene
from rcmservo.sim.tool_body import ToolBody
from rcmservo.study import StudyRun
from rcmservo.study.compiled_engine import FIRST_TICK_NS, CompiledEngine
from rcmservo.study.execution.chunk import run_seed
from rcmservo.study.kernel_engine import StudyGoal
from rcmservo.study.plan.file import StudyFile, make_plan
from rcmservo.study.plant_kernel import advance_plant, queue_command, read_encoders, reset_plant
from rcmservo.study.simulation_engine import SimulationEngine

QUIET = RigSettings(point_noise=0.0)
WRIST = RigSettings(mechanism=PitchYawRcm(), tool=ScaledTool(1.3), point_noise=0.0)
NOISY, NOISY_WRIST = (replace(settings, point_noise=0.3) for settings in (QUIET, WRIST))
INACCURATE = Drive(encoder_offset=(0.02, -0.03, 2.0), rate_error=(0.01, -0.012, 0.015))
TOLERANCE_MM = 1e-3
"""Difference that rounding, amplified by encoder counts, may cause, mm."""
FRAME_PERIOD_S = 1.0 / 60.0


def make_study(settings: RigSettings, **options: float) -> CompiledEngine:
    return CompiledEngine(Servo(settings.mechanism, settings.tool), settings, **options)


def run_mujoco(study: CompiledEngine, seed: int) -> StudyRun:
    """Run the same closed loop with MuJoCo's arm and the live code."""
    return SimulationEngine(study.servo, study.settings, study.duration, study.teaching_frames).run(
        seed
    )


def make_goal(seed: int, settings: RigSettings) -> StudyGoal:
    """Return the target of a seed without noise."""
    scene, _ = sample_scene_of_seed(seed, settings)
    markers = scene.body.points(scene.target)[:2]
    return StudyGoal(scene.optics.project(markers), scene.target, markers[1])


def run_both(study: CompiledEngine, seed: int) -> StudyRun:
    """Return the compiled closed loop after checking that MuJoCo's agrees with it."""
    compiled, mujoco = study.run(seed), run_mujoco(study, seed)
    assert np.abs(compiled.error - mujoco.error).max() < TOLERANCE_MM
    assert np.count_nonzero(compiled.phases != mujoco.phases) <= 2
    assert compiled.first_within(1.0) == pytest.approx(mujoco.first_within(1.0), abs=FRAME_PERIOD_S)
    assert compiled.pose_error == pytest.approx(mujoco.pose_error, rel=0.05)
    assert compiled.bound == mujoco.bound and compiled.stops == mujoco.stops
    return compiled


@pytest.mark.parametrize(
    "scene",
    mark_others_slow(
        [(WRIST, 1), *((settings, n) for settings in (QUIET, WRIST) for n in (2, 3, 4))]
    ),
)
def test_the_compiled_plant_agrees_with_the_simulated_arm(scene: tuple[RigSettings, int]) -> None:
    settings, seed = scene
    run = run_both(make_study(settings, duration=5.0), seed)
    assert run.error[0] > 10.0 and run.error[-1] < 0.5


@pytest.mark.parametrize("estimator", [DltEstimator(), ProjectionEstimator()])
@pytest.mark.parametrize(
    "scene",
    [
        *((NOISY, seed) for seed in (0, 3)),
        *(
            pytest.param((settings, seed), marks=pytest.mark.slow)
            for settings in (NOISY, NOISY_WRIST)
            for seed in range(4, 8)
        ),
    ],
)
def test_with_the_same_noise_the_compiled_plant_agrees_with_the_simulated_arm(
    scene: tuple[RigSettings, int], estimator: Estimator
) -> None:
    """In scene 3 a decision depends on less than a millisecond.

    Without inertia, the final error of the compiled plant would differ by a quarter.
    """
    settings, seed = scene
    servo = Servo(settings.mechanism, settings.tool, estimator)
    run = run_both(CompiledEngine(servo, settings, duration=4.0), seed)
    quiet = CompiledEngine(servo, replace(settings, point_noise=0.0), duration=4.0).run(seed)
    assert np.abs(run.error - quiet.error).max() > 10.0 * TOLERANCE_MM


@pytest.mark.parametrize(
    "scene", mark_others_slow([(noisy, n) for n in range(2) for noisy in (NOISY, NOISY_WRIST)])
)
def test_the_compiled_plant_has_the_drive_errors_of_the_simulated_arm(
    scene: tuple[RigSettings, int],
) -> None:
    accurate, seed = scene
    settings = replace(accurate, drive=INACCURATE)
    servo = Servo(settings.mechanism, settings.tool, DltEstimator())
    run = run_both(CompiledEngine(servo, settings, duration=4.0), seed)
    assert run.error[-1] < 1.0 and not run.stops
    assert (
        np.abs(run.error - CompiledEngine(servo, accurate, duration=4.0).run(seed).error).max()
        > 0.1
    )


def test_joints_start_to_move_beyond_the_stiction_on_both_plants() -> None:
    settings = replace(NOISY, drive=Drive(stiction=(0.02, 0.02, 2.0)))
    study = make_study(settings, duration=4.0)
    compiled, mujoco = study.run(1), run_mujoco(study, 1)
    assert np.abs(compiled.error - mujoco.error).max() < TOLERANCE_MM
    ideal = make_study(NOISY, duration=4.0).run(1)
    assert np.abs(compiled.error - ideal.error).max() > 1e-3


def test_the_target_of_a_study_has_the_joints_that_the_arm_reports() -> None:
    """The true joints differ by 20 mm, and the servo would reject the target's pose."""
    offset = replace(NOISY, drive=Drive(encoder_offset=(0.1, 0.1, 5.0)))
    run = CompiledEngine(
        Servo(offset.mechanism, offset.tool, DltEstimator()), offset, duration=6.0
    ).run(2)
    assert not run.stops and run.error[-1] < 1.0


def test_other_drives_change_the_run() -> None:
    slow = replace(QUIET, drive=Drive(lag=0.021))
    default, slower = (make_study(settings, duration=4.0).run(0) for settings in (QUIET, slow))
    assert np.abs(default.error - slower.error).max() > TOLERANCE_MM


def test_excessive_noise_stops_the_run_with_a_cause() -> None:
    run = make_study(RigSettings(point_noise=5.0), duration=12.0).run(0)
    assert run.stops and run.stops[0][1] is Cause.NOT_EXPLORED
    assert run.first_within(0.0) == np.inf
    for noise in (0.0, 1.0):
        assert not make_study(RigSettings(point_noise=noise), duration=5.0).run(0).stops


@pytest.mark.slow
def test_an_estimator_that_averages_markers_reaches_a_smaller_error_in_the_same_time() -> None:
    """With 0.3 px of noise, `projection` acts on measured markers and `dlt` on fitted ones."""
    servos = [
        Servo(SphericalRcm(), RigidTool(30.0), estimator)
        for estimator in (ProjectionEstimator(), DltEstimator())
    ]
    measured, averaged = (
        [CompiledEngine(servo, teaching_frames=300).run(seed) for seed in range(12)]
        for servo in servos
    )
    errors = [np.median([run.error[-300:].mean() for run in runs]) for runs in (measured, averaged)]
    times = [np.median([run.first_within(1.0) for run in runs]) for runs in (measured, averaged)]
    assert errors[1] < 0.7 * errors[0] < 0.3
    assert times[1] < 1.1 * times[0] < 6.0


def make_endoscopic_scene(optics: CameraModel, body: ToolBody) -> Scene:
    """Return a scene of an endoscope in a second port, with the arm's RCM behind the camera."""
    q = np.array([0.6, 0.3, 120.0])
    start, port = body.points(q)[:2].mean(axis=0), np.array([-80.0, 40.0, 0.0])
    axis = (start - port) / np.linalg.norm(start - port)
    position = start - 80.0 * axis
    endoscope = replace(
        optics, focal=600.0, position=position, rotation=compute_look_at_rotation(position, start)
    )
    assert endoscope.depth(np.zeros((1, 3)))[0] < 0.0
    target = q + np.array([0.08, 0.1, 9.0])
    return Scene(endoscope, body, np.stack([q, target]), q, Tissue(position, axis), 0)


@pytest.mark.parametrize(
    ("estimator", "arrives"), [(DltEstimator(), True), (ProjectionEstimator(), False)]
)
def test_with_the_rcm_behind_the_camera_only_the_full_projection_converges(
    estimator: Estimator, arrives: bool
) -> None:
    settings = replace(QUIET, tool=RigidTool(15.0))
    body = ToolBody(settings.mechanism, settings.tool)
    scene = make_endoscopic_scene(sample_scene_of_seed(0, QUIET)[0].optics, body)
    study = CompiledEngine(Servo(settings.mechanism, settings.tool, estimator), settings)
    markers = body.points(scene.target)[:2]
    goal = StudyGoal(scene.optics.project(markers), scene.target, markers[1])
    run = study.of(0, scene, goal, np.zeros((1000, 2, 2)))
    assert run.error[0] > 10.0 and (run.error[-1] < 0.5) == arrives


def test_times_of_a_run_count_from_its_first_tick() -> None:
    phases = [Phase.SERVO, Phase.HOLD, Phase.HOLD, Phase.ACQUIRE, Phase.FAULT]
    phase_codes = np.array([PHASES.index(phase) for phase in phases], np.int8)
    causes = np.array([0, Cause.STALE.code, Cause.STALE.code, 0, Cause.DRIVE_OFF.code], np.int8)
    run = StudyRun(
        0,
        100.0,
        np.array([3.0, 2.0, 1.0, 0.5, 1.5]),
        phase_codes,
        causes,
        0.1,
        sample_scene_of_seed(0, QUIET)[0],
    )
    assert run.first_within(1.0) == 0.02
    assert run.stops == [(0.01, Cause.STALE), (0.04, Cause.DRIVE_OFF)]
    stopped = replace(run, phases=phase_codes[1:], causes=causes[1:])
    assert stopped.stops == [(0.0, Cause.STALE), (0.03, Cause.DRIVE_OFF)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"servo": Servo(SphericalRcm(), RigidTool(30.0), FlowEstimator())}, "servo.estimator"),
        ({"duration": np.nan}, "duration must be a positive time"),
        ({"teaching_frames": 0}, "teaching_frames"),
        ({"servo": Servo(PitchYawRcm(), RigidTool(30.0))}, "servo.mechanism"),
        ({"servo": Servo(SphericalRcm(), RigidTool(29.0))}, "servo.tool"),
        ({"settings": RigSettings(drive=Drive(delay=1.0)), "servo": None}, "drive.delay"),
    ],
)
def test_an_invalid_study_raises_an_error_that_names_the_field(
    arguments: dict, message: str
) -> None:
    fast = Servo(SphericalRcm(), RigidTool(30.0), rate=200.0)
    if arguments.get("servo") is None:
        arguments = arguments | {"servo": fast}
    with pytest.raises(BadInput, match=message):
        CompiledEngine(**arguments)


def test_an_invalid_seed_or_noise_raises_an_error() -> None:
    study = make_study(QUIET, duration=1.0)
    with pytest.raises(BadInput, match="seed must be"):
        study.run(-1)
    scene, _ = sample_scene_of_seed(0, QUIET)
    with pytest.raises(BadInput, match="noise must be"):
        study.of(0, scene, make_goal(0, QUIET), np.zeros((10, 2, 2)))


def test_given_noise_belongs_to_the_frame_number_even_if_frames_are_skipped() -> None:
    noise = np.arange(40.0).reshape(10, 2, 2) / 100.0
    rig, noiseless = (Rig(0, QUIET, pictures=False) for _ in range(2))
    rig.set_point_noise(noise)
    first = noiseless.camera.latest()
    for ms in (1.0, 40.0, 20.0, 100.0):
        for lab in (rig, noiseless):
            lab.clock.wait_until(lab.clock.now() + round(ms * 1e6))
        frame, expected = rig.camera.latest(), noiseless.camera.latest()
        count = frame.number - first.number
        added = noise[count - 1] if count else 0.0
        np.testing.assert_allclose(frame.points - expected.points, added, atol=1e-9)
    assert count == 10
    rig.clock.wait_until(rig.clock.now() + 20_000_000)
    with pytest.raises(BadInput, match="noise must be of at least 11 frames"):
        rig.camera.latest()


def test_given_noise_of_another_shape_or_for_rendered_frames_raises_an_error() -> None:
    with pytest.raises(BadInput, match=r"noise must be of shape \(frames, 2, 2\)"):
        Rig(0, QUIET, pictures=False).set_point_noise(np.zeros((10, 4)))
    with pytest.raises(BadInput, match="camera must be the one without pictures"):
        Rig(0, QUIET).set_point_noise(np.zeros((10, 2, 2)))


def test_the_compiled_plant_stops_at_the_hard_stop_of_the_true_joints() -> None:
    study = make_study(replace(QUIET, drive=INACCURATE))
    plant = study._make_plant(0, sample_scene_of_seed(0, QUIET)[0])
    row = plant.rows[0]
    reset_plant(row, FIRST_TICK_NS)
    for k in range(500):
        queue_command(row, np.array([0.0, 0.0, 100.0]), True)
        advance_plant(row, FIRST_TICK_NS + (k + 1) * 10_000_000)
    lower, upper = study.settings.mechanism.limits.arrays
    stop = (lower + upper) / 2.0 + HARD_STOP_RATIO * (upper - lower) / 2.0
    reading = np.empty(3)
    read_encoders(row, reading)
    assert plant.drives.q[2] == stop[2]
    assert reading[2] == pytest.approx(stop[2] + INACCURATE.encoder_offset[2], abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "seeds"), [("dlt", range(3)), ("projection", range(10, 13))])
def test_both_engines_agree_in_every_scene(method: str, seeds: range) -> None:
    plan = make_plan(StudyFile(methods=(method,), count=1), {})
    compiled = plan.cells[0]
    mujoco = replace(compiled, engine="mujoco")
    servo = compiled.rebuild_servo({})
    for seed in seeds:
        rows = [run_seed(cell, servo, seed) for cell in (compiled, mujoco)]
        first, second = rows
        assert first.success == second.success and first.stop == second.stop, seed
        times = [np.inf if row.time_to_1mm_s is None else row.time_to_1mm_s for row in rows]
        assert times[0] == pytest.approx(times[1], abs=FRAME_PERIOD_S), seed
        assert first.pose_error_mm == pytest.approx(second.pose_error_mm, rel=0.05), seed
        assert (first.bound_mm, first.condition) == (second.bound_mm, second.condition)
        assert first.unnoticed_mm == pytest.approx(second.unnoticed_mm, abs=0.01), seed


IMPERFECTIONS = {
    "axis_distance": 2.0,
    "insertion_distance": 2.0,
    "marker_distance": 2.0,
    "backlash": (0.005, 0.005, 0.3),
    "spacing_error": -0.1,
    "insertion_error": 10.0,
    "friction_bend": 0.02,
    "tissue_bend": 0.1,
    "port_motion": 1.0,
    "gain_error": 0.03,
    "report_period": 0.02,
    "stamp_error": 0.004,
    "read_out": 0.01,
    "focus": 0.0005,
    "air": 0.2,
}


@pytest.mark.parametrize("name", [*IMPERFECTIONS, "worn"])
def test_an_imperfect_arm_is_the_same_on_both_plants(name: str) -> None:
    """The runs differ from those of an ideal arm, so that the imperfection acts on both."""
    settings = NOISY_WRIST if name == "marker_distance" else NOISY
    ideal = make_study(settings, duration=4.0).run(1)
    if name == "worn":
        imperfect = read_rig_settings(RigDescription(), "worn")
    else:
        errors = Imperfections(**{name: IMPERFECTIONS[name], "roll": 0.2})
        imperfect = replace(settings, imperfections=errors)
    study = make_study(imperfect, duration=4.0)
    compiled, mujoco = study.run(1), run_mujoco(study, 1)
    assert np.abs(compiled.error - mujoco.error).max() < TOLERANCE_MM
    assert np.array_equal(compiled.causes, mujoco.causes)
    assert np.abs(compiled.error - ideal.error).max() > 1e-3
