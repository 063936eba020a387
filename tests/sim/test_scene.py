"""Scenes with given initial errors, relocated cameras, and continued runs."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import make_laboratory, mark_others_slow
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase, Request
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Rig, RigSettings, SceneSettings
from rcmservo.tracking import PointMarkers

ERRORS = (float(np.radians(40.0)), -80.0, -60.0)


def true_error(rig, q):
    o_c = rig.truth.imaged_rcm()
    y, y_d = (
        compute_features(shift_to_rcm(rig.truth.pixels(joints), o_c))
        for joints in (q, rig.scene.target)
    )
    return compute_feature_error(y, y_d)


@pytest.mark.parametrize("seed", mark_others_slow(range(4)))
@pytest.mark.parametrize("errors", [ERRORS, (-0.3, 30.0, -20.0)])
def test_a_scene_starts_with_exactly_the_requested_errors(seed, errors):
    rig = Rig(
        seed,
        RigSettings(
            scene=SceneSettings(errors=errors, insertion=(40.0, 70.0), distance=(150.0, 400.0))
        ),
    )
    np.testing.assert_allclose(true_error(rig, rig.scene.start), errors, atol=1e-7)
    np.testing.assert_allclose(
        true_error(rig, rig.scene.midpoint), np.array(errors) / 2.0, atol=1e-7
    )
    sizes = np.abs([true_error(rig, q) for q in rig.scene.path])
    assert (np.diff(sizes, axis=0) <= 1e-6).all(), "no error grows on the path"
    assert np.abs(np.diff(rig.scene.path, axis=0))[:, :2].max() < 1.0, (
        "the path does not jump at the angles' wrap"
    )


@pytest.mark.parametrize("errors", [(np.nan, 1.0, 1.0), (0.0, 0.0, 0.0)])
def test_errors_that_make_no_scene_are_refused(errors):
    with pytest.raises(BadInput, match=r"scene\.errors"):
        SceneSettings(errors=errors)


def test_errors_together_with_a_given_start_are_refused():
    with pytest.raises(BadInput, match=r"scene\.errors"):
        SceneSettings(errors=ERRORS, start=(0.5, 0.3, 100.0))


def test_a_relocated_camera_stops_the_servo_until_it_has_explored_again():
    lab = make_laboratory(seed=2)
    servo = lab.servo()
    state = None
    for tick in servo_ticks(lab.plant, servo, lab.target, 20.0, until=lambda t: t.state.explored):
        state = tick.state
    before = lab.rig.truth.pixels(lab.rig.scene.start)
    lab.rig.relocate_camera()
    assert np.abs(lab.rig.truth.pixels(lab.rig.scene.start) - before).max() > 10.0
    held = list(servo_ticks(lab.plant, servo, lab.target, 5.0, state=state))
    assert held[-1].state.phase is Phase.PAUSED
    assert held[-1].state.cause is Cause.CAMERA_MOVED
    again = list(servo_ticks(lab.plant, servo, lab.target, 1.0, state=held[-1].state))
    assert again[-1].state.cause is Cause.TARGET_OLD, "the target of the old view is refused"
    assert not any(tick.applied.any() for tick in again)
    lab.rig.move_to_target()
    target = teach(lab.plant, frames=30)
    lab.rig.go_home()
    *_, last = servo_ticks(lab.plant, servo, target, 12.0, state=again[-1].state)
    assert last.state.phase is Phase.SERVO
    assert (np.abs(last.state.delta) < (0.02, 2.0, 2.0)).all()


def test_a_camera_bumped_during_exploration_is_detected():
    """The markers' permitted motion grows while the tool moves; the bump must exceed it."""
    rig = Rig(
        498,
        RigSettings(point_noise=0.1),
        pictures=False,
        disturbances=[Disturbance.parse("camera_pan:at=1.828,px=17.1")],
    )
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = teach(plant, frames=30)
    rig.go_home()
    rig.begin()
    *_, last = servo_ticks(plant, Servo(rig.settings.mechanism, rig.settings.tool), target, 4.0)
    assert last.state.cause is Cause.CAMERA_MOVED and last.time < 1.95e9


def test_a_target_taught_during_the_pause_is_accepted():
    """Only targets from before the camera's motion are refused.

    That holds even if another cause prolongs the pause.
    """
    lab = make_laboratory(seed=2)
    servo = lab.servo()
    *_, there = servo_ticks(lab.plant, servo, lab.target, 20.0, until=lambda t: t.state.explored)
    lab.rig.relocate_camera()
    *_, held = servo_ticks(lab.plant, servo, lab.target, 1.0, state=there.state)
    assert held.state.cause is Cause.CAMERA_MOVED
    fresh = replace(lab.target, points=lab.target.points + 1.0, taught_at=held.observation.now)
    state, observation = held.state, held.observation
    for recorded, request in ((False, Request.NONE), (True, Request.RESUME)):
        observation = replace(
            observation,
            now=observation.now + 10_000_000,
            q_time=observation.now + 10_000_000,
            enabled=True,
            recorded=recorded,
        )
        state = servo.step(state, replace(observation, arrival=observation.now), fresh, request)
    assert state.phase is Phase.ACQUIRE


def test_a_run_continues_an_earlier_one_with_its_estimate_and_from_rest():
    lab = make_laboratory(seed=3)
    servo = lab.servo()
    *_, first = servo_ticks(
        lab.plant,
        servo,
        lab.target,
        20.0,
        until=lambda t: t.state.explored and t.observation.frame % 7 == 0,
    )
    ticks = servo_ticks(lab.plant, servo, lab.target, 1.0, state=first.state)
    again = next(ticks)
    assert again.state.explored and again.state.J_hat is not None
    slew = np.array(servo.gate.slew) * servo.gate.max_period
    assert (np.abs(again.state.command.rates) <= slew + 1e-12).all()


def test_a_new_target_gives_the_stall_rule_a_new_start():
    lab = make_laboratory(seed=3)
    servo = lab.servo()
    *_, there = servo_ticks(lab.plant, servo, lab.target, 8.0)
    lab.rig.go_home()
    elsewhere = teach(lab.plant, frames=30)
    lab.rig.move_to_target()
    *_, last = servo_ticks(lab.plant, servo, elsewhere, 8.0, state=there.state)
    assert last.state.phase is Phase.SERVO
    assert (np.abs(last.state.delta) < (0.02, 2.0, 2.0)).all()


def test_a_component_that_rises_while_the_potential_falls_is_no_stall():
    scene = SceneSettings(errors=ERRORS, insertion=(40.0, 70.0), distance=(150.0, 400.0), room=17.0)
    lab = make_laboratory(seed=0, settings=RigSettings(scene=scene, point_noise=0.1))
    printed = SaturatedController(gain=0.1, bounds=(float(np.radians(10.0)), 10.0, 10.0))
    printed_fit = ProjectionEstimator(
        gamma="printed", observations=10, both_markers=False, estimator_time=1e4
    )
    servo = lab.servo(controller=printed, estimator=printed_fit)
    *_, last = servo_ticks(lab.plant, servo, lab.target, 30.0)
    assert last.state.cause is Cause.NONE


def test_after_the_tool_is_moved_by_hand_no_frame_has_earlier_joints():
    lab = make_laboratory(seed=2)
    lab.rig.move_to_target()
    teach(lab.plant, frames=5)
    lab.rig.go_home()
    home = lab.rig.scene.start
    observations = [
        tick.observation
        for tick in servo_ticks(lab.plant, lab.servo(), lab.target, 0.1)
        if tick.observation.frame >= 0
    ]
    assert observations
    assert all(np.abs(one.q_exposure - home).max() < 0.1 for one in observations)
