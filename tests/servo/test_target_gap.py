"""Target that the image and the joints of teaching determine together, and their contradiction.

The scenes and targets are those of the compiled plant, whose targets the tests change.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import rcmservo as rs
from conftest import ESTIMATORS, mark_others_slow
from rcmservo.config.rig_file import RigDescription
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.safety.causes import Cause
from rcmservo.sim import Drive, Rig, RigSettings
from rcmservo.sim.camera_kernels import CameraStruct
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.kernel_engine import StudyGoal
from rcmservo.study.plan.distribution import load_built_in
from rcmservo.study.run_outcome import StudyRun
from rcmservo.tracking import PointMarkers

Change = Callable[[int, StudyGoal], StudyGoal]

FAR_MM = 1.5
"""Error (mm) of a tool at rest that must be reported."""

BOTH = SaturatedController()
"""Controller that trusts the image and the joints of teaching."""

ALONE = SaturatedController(joint_trust=0.0)
"""Controller that trusts the image alone."""


@cache
def engine(
    arm: str, controller: SaturatedController = BOTH, estimator: str = "dlt"
) -> CompiledEngine:
    settings = read_rig_settings(RigDescription(), arm)
    servo = rs.Servo(
        settings.mechanism, settings.tool, ESTIMATORS[estimator], controller=controller
    )
    return CompiledEngine(servo, settings, duration=8.0)


def run_with_target(
    seed: int,
    arm: str,
    controller: SaturatedController = BOTH,
    change: Change | None = None,
) -> StudyRun:
    scene, goal, noise = engine(arm, controller).draw_trial(seed, 0)
    goal = change(seed, goal) if change else goal
    return engine(arm, controller).of(seed, scene, goal, noise)


def count_near(arm: str, controller: SaturatedController, seeds: range) -> int:
    runs = [run_with_target(seed, arm, controller) for seed in seeds]
    return sum(run.pose_error <= 1.0 and run.held is Cause.NONE for run in runs)


def test_a_good_arm_arrives_within_a_millimetre() -> None:
    assert count_near("good", BOTH, range(41000, 41100)) >= 97


@pytest.mark.parametrize(("controller", "least", "most"), [(BOTH, 86, 100), (ALONE, 0, 80)])
def test_an_estimator_of_single_frames_arrives_on_a_good_arm_with_the_joints(
    controller: SaturatedController, least: int, most: int
) -> None:
    """Slow motions of the air move the raw markers, in weak directions by more than a mm."""
    runs = [engine("good", controller, "fast").run(seed) for seed in range(41000, 41100)]
    near = sum(run.pose_error <= 1.0 and run.held is Cause.NONE for run in runs)
    assert least <= near <= most


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "least"), [("ideal", 196), ("good", 196), ("worn", 180)])
def test_the_joints_help_each_arm(arm: str, least: int) -> None:
    assert count_near(arm, BOTH, range(41000, 41200)) >= least


@pytest.mark.slow
def test_the_image_alone_is_less_accurate_on_an_imperfect_arm() -> None:
    """The opposite of the above: without the joints as many runs of a good arm fail as before."""
    assert count_near("good", ALONE, range(41000, 41200)) <= 194
    assert count_near("ideal", ALONE, range(41000, 41200)) >= 196


@cache
def hard_engine(trust: float) -> CompiledEngine:
    """Return the engine of scenes with a singular surface near the path."""
    _, settings = load_built_in("hard").draw(0)
    controller = SaturatedController(joint_trust=trust)
    servo = rs.Servo(settings.mechanism, settings.tool, controller=controller)
    return CompiledEngine(servo, settings, duration=12.0)


def test_the_joints_lead_back_from_a_detour_and_from_a_pose_that_looks_the_same() -> None:
    """The image alone leads away by up to 100 mm, and half of the runs do not arrive."""
    helped = [hard_engine(1.0).run(seed) for seed in range(45000, 45030)]
    alone = [hard_engine(0.0).run(seed) for seed in range(45000, 45030)]
    near, near_alone = (sum(run.pose_error <= 1.0 for run in runs) for runs in (helped, alone))
    assert near >= 28 and near_alone <= 24
    assert max(map(growth, helped)) < 15.0 < max(map(growth, alone))


def growth(run: StudyRun) -> float:
    """Return how far the error grows after the exploration, mm."""
    errors = run.error[round(run.explored * run.rate) :]
    return float((errors - np.minimum.accumulate(errors)).max())


def move_insertion(seed: int, goal: StudyGoal) -> StudyGoal:
    """The insertion has been reported 3 mm wrong since teaching."""
    return goal._replace(q=goal.q + np.array([0.0, 0.0, 3.0 if seed % 2 else -3.0]))


def zoom_out(seed: int, goal: StudyGoal) -> StudyGoal:
    """The focal length is 3 % shorter than while teaching."""
    centre = CameraStruct(engine("good").draw_trial(seed, 0)[0].optics.lens).centre
    return goal._replace(points=centre + (goal.points - centre) / 0.97)


def displace_marker(seed: int, goal: StudyGoal) -> StudyGoal:
    """A marker was 8 px wrong throughout teaching."""
    angle, points = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi), goal.points.copy()
    points[seed % 2] += 8.0 * np.array([np.cos(angle), np.sin(angle)])
    return goal._replace(points=points)


CASES = [
    (change, arm)
    for arm in ("good", "ideal")
    for change in (zoom_out, move_insertion, displace_marker)
]


@pytest.mark.parametrize("case", mark_others_slow(CASES))
def test_a_target_that_the_joints_contradict_is_reported(case: tuple[Change, str]) -> None:
    """Without the comparison on arrival 3 to 17 of 100 such runs rest far off without a report."""
    change, arm = case
    for seed in range(42000, 42040):
        run = run_with_target(seed, arm, change=change)
        assert run.held is not Cause.NONE or run.pose_error <= FAR_MM, seed
        assert run.held in (Cause.NONE, Cause.IMPLAUSIBLE, Cause.ELSEWHERE), seed


@pytest.mark.parametrize("trust", [1.0, 0.0])
@pytest.mark.parametrize("has_joints", [True, False])
def test_the_servo_aims_at_the_taught_pixels_unless_joints_help(
    trust: float, has_joints: bool
) -> None:
    settings = read_rig_settings(RigDescription(), "good")
    rig = Rig(41003, settings, pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    taught = teach(plant, frames=30)
    target = taught if has_joints else replace(taught, q=np.full(3, np.nan))
    rig.go_home()
    controller = SaturatedController(joint_trust=trust)
    servo = rs.Servo(settings.mechanism, settings.tool, controller=controller)
    helped = False
    for tick in servo_ticks(plant, servo, target, 3.0):
        if tick.state.newest_frame < 0:
            continue
        equal = np.array_equal(tick.state.decision.aim, target.points)
        assert equal or (tick.state.explored and has_joints and trust > 0.0)
        helped = helped or not equal
    assert helped == (has_joints and trust > 0.0)


def test_a_drive_with_a_long_lag_does_not_overshoot() -> None:
    """Without the prediction over the lag, joints with 150 ms swing about the target."""
    settings = RigSettings(drive=Drive(lag=0.146), point_noise=0.1)
    servo = rs.Servo(settings.mechanism, settings.tool)
    slow = CompiledEngine(servo, settings, duration=8.0)
    growths = [overshoot(slow.run(seed)) for seed in range(43000, 43020)]
    assert np.median(growths) < 1.0


def overshoot(run: StudyRun) -> float:
    """Return how far the error grows again after it was first below a millimetre, mm."""
    first = int(np.argmax(run.error <= 1.0))
    return float(run.error[first:].max())


@pytest.mark.parametrize("seed", [44000, 44001, 44002])
def test_a_worn_arm_brakes_with_its_measured_response(seed: int) -> None:
    """A cause that resets the estimate once replaced the lag too; braking was NOT_FOLLOWING."""

    def mistake_marker(_: int, goal: StudyGoal) -> StudyGoal:
        return goal._replace(points=goal.points + np.array([[25.0, 0.0], [0.0, 0.0]]))

    run = run_with_target(seed, "worn", change=mistake_marker)
    assert run.held is Cause.IMPLAUSIBLE
