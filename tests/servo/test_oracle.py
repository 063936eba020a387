"""Compiled functions give the numbers of the same source run as plain Python, the oracle."""

import subprocess
import sys
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from conftest import find_compiled_functions, make_environment

TOLERANCE = 1e-9


def camera():
    """Return the projection matrix C of a fixed camera before the tool and the RCM.

    It is written out so that this file does not depend on the simulation.
    """
    forward, right = np.array([0.6, 0.2, -0.7746]), np.array([0.31623, -0.94868, 0.0])
    forward = forward / np.linalg.norm(forward)
    right = right - (right @ forward) * forward
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    position = np.array([20.0, -10.0, -100.0]) - 260.0 * forward
    return np.diag([700.0, 700.0, 1.0]) @ np.column_stack([rotation, -rotation @ position])


def pixels(C, p1, spacing=30.0):
    points = np.stack([p1, p1 * (1.0 + spacing / np.linalg.norm(p1))])
    image = np.column_stack([points, np.ones(2)]) @ C.T
    return image[:, :2] / image[:, 2:] + np.array([320.0, 240.0])


def radii(C, p1, spacing=30.0):
    """Return the apparent radii (2,) in px of balls with 1000 px at a depth of 1 mm."""
    points = np.stack([p1, p1 * (1.0 + spacing / np.linalg.norm(p1))])
    return 1000.0 / (np.column_stack([points, np.ones(2)]) @ C[2])


class Scene(NamedTuple):
    """Eight positions of a tool before a camera, with their noisy images."""

    a: np.ndarray
    o_c: np.ndarray
    positions: np.ndarray
    rows: np.ndarray
    y: np.ndarray
    delta: np.ndarray
    J: np.ndarray

    @property
    def points(self):
        return self.rows[0, 3:].reshape(2, 2)

    @property
    def target(self):
        return self.rows[1, 3:].reshape(2, 2)

    @property
    def step(self):
        return self.positions[1] - self.positions[0]


P, N, SPACING = np.array([20.0, -10.0, -100.0]), 8, 30.0


def make_scene():
    from rcmservo.estimation import projection_rule as fit
    from rcmservo.geometry import features, projection, tool

    random, C = np.random.default_rng(0), camera()
    a, o_c = projection.extract_parameters(C)
    o_c = o_c + np.array([320.0, 240.0])
    positions = P + random.uniform(-15, 15, (N, 3))
    rows = np.stack(
        [np.concatenate([position, pixels(C, position).ravel()]) for position in positions]
    )
    rows[:, 3:] += 0.3 * random.standard_normal((N, 4))
    points, target = rows[0, 3:].reshape(2, 2), rows[1, 3:].reshape(2, 2)
    y, delta = features.compute_features_and_error(points, target, o_c)
    m = features.shift_to_rcm(points, o_c)
    J = fit.compute_estimated_jacobian(a, positions[0], m, tool.ToolStruct(0, SPACING))
    return Scene(a, o_c, positions, rows, y, delta, J)


def run_geometry():
    """Return results of mechanism, tool and exploration."""
    from rcmservo.bringup import identification
    from rcmservo.geometry import kinematics, tool
    from rcmservo.numerics.small_linalg import compute_distance, cross

    results, limits = {}, ((-1.0, -1.0, 40.0), (1.0, 1.0, 93.0))
    for kind in (0, 1):
        q, v = np.array([0.4, -0.3, 90.0]), np.array([10.0, -20.0, 5.0])
        rcm, shaft = kinematics.RcmStruct(kind, 2.0, *limits), tool.ToolStruct(kind, 1.3)
        p = kinematics.compute_position(rcm, q)
        joint, rates = kinematics.find_blocking_joint(rcm, q, 99.0 * p, np.ones(3), 0.1, 0.3)
        results |= {
            f"axis {kind}": kinematics.compute_axis(rcm, q),
            f"axis_jacobian {kind}": kinematics.compute_axis_jacobian(rcm, q),
            f"position {kind}": p,
            f"distance {kind}": compute_distance(p, v),
            f"cross {kind}": cross(p, v),
            f"position_jacobian {kind}": kinematics.compute_position_jacobian(rcm, q),
            f"joints {kind}": kinematics.compute_joints(rcm, p),
            f"joint_rates {kind}": kinematics.compute_joint_rates(rcm, q, v),
            f"blocking joint {kind}": np.array([joint, *rates]),
            f"marker ratio {kind}": tool.compute_marker_ratio(tool.ToolStruct(kind, SPACING), p),
            f"second_marker {kind}": tool.compute_second_marker(shaft, p),
            f"second_marker_jacobian {kind}": tool.compute_second_marker_jacobian(shaft, p),
            f"_compute_markers {kind}": identification._compute_markers(
                rcm, np.array([q, q + 0.1]), shaft
            ),
        }
        results |= run_exploration(kind, rcm, q)
    return results


def run_exploration(kind, rcm, q):
    """Return results of two rounds of the exploration."""
    from rcmservo.control import exploration
    from rcmservo.numerics.structs import to_row

    results, x, max_rates = {}, to_row(exploration.Exploration())[0], np.array([1.0, 1.0, 80.0])
    state = exploration.ExplorationState.of()
    row = state.rows[0]
    exploration.start_exploration(row, rcm, max_rates, q, 5, 0.01, x)
    for visits in (0, 4):
        state.rows["visited_corners"] = visits
        results[f"has room {kind} {visits}"] = exploration.set_round(row, rcm, max_rates, 0.01, x)
        results[f"sides {kind} {visits}"] = state.sides.copy()
        results[f"rates to corner {kind} {visits}"] = exploration.compute_rates_to_corner(
            row, max_rates, q + 0.01, 0.0, x
        )
        results[f"is at corner {kind} {visits}"] = exploration.is_at_corner(
            row, state.next_corner, q + 0.9 * state.sides
        )
    results[f"max leg length {kind}"] = exploration.compute_max_leg_length(rcm, q, state.sides)
    results[f"overdue {kind}"] = exploration.is_overdue(row, 10**12, x)
    return results


def run_imaging(scene):
    """Return results of projection, features and imaged RCM."""
    from rcmservo.control import exploration
    from rcmservo.geometry import features, imaged_rcm, projection
    from rcmservo.numerics import small_svd

    m, line_jacobian = features.shift_to_rcm(scene.points, scene.o_c), np.empty((3, 4))
    features.write_line_features_jacobian(m, line_jacobian)
    results = {
        "depth": projection.compute_depth(scene.a, P),
        "project": projection.project(scene.a, P),
        "project_jacobian": projection.compute_projection_jacobian(scene.a, P),
        "regressor": projection.build_regressor(np.array([10.0, 20.0]), P),
        "about": m,
        "y": scene.y,
        "delta": scene.delta,
        "features": features.compute_features(m),
        "features_jacobian": features.compute_features_jacobian(m),
        "J": scene.J,
        "condition": small_svd.compute_condition(scene.J),
        "relative difference": exploration.compute_relative_difference(scene.J, scene.J + 0.01),
        "line features": features.compute_line_features(m),
        "line features jacobian": line_jacobian,
        "limited origin": features.limit_origin_distance(scene.o_c, scene.points, 100.0),
    }
    for follows_paper, shape in ((True, (6, 4)), (False, (7, 3))):
        memory, count = np.zeros(shape), 0
        for row in scene.rows:
            points = row[3:].reshape(2, 2)
            memory, count, solution = imaged_rcm.update_imaged_rcm(
                memory, count, points, follows_paper
            )
        results |= {
            f"lines {follows_paper}": memory,
            f"imaged rcm {follows_paper}": solution.o_c,
            f"rcm covariance {follows_paper}": solution.covariance,
            f"rcm condition {follows_paper}": np.log(solution.condition),
            f"rcm uncertainty {follows_paper}": imaged_rcm.compute_uncertainty(
                solution, scene.points[0], 1e3, 0.5, follows_paper
            ),
        }
    return results | {"sum of lines": imaged_rcm.sum_lines(scene.rows[:, 3:].copy())}


def run_projection_rule(scene):
    """Return results of the projection estimator, with both Γ."""
    from rcmservo.estimation import projection_rule as fit
    from rcmservo.geometry import tool
    from rcmservo.numerics import gradient_flow
    from rcmservo.servo.state import EstimatorMemory
    from rcmservo.servo.update_estimate import empty_with_lines

    a, o_c, rows, shaft, results = scene.a, scene.o_c, scene.rows, tool.ToolStruct(0, SPACING), {}
    for both in (False, True):
        fitted = fit.collect_fitted_points(rows, N, o_c, both, shaft)
        A, b = fit.build_normal_equations(fitted)
        results[f"A {both}"], results[f"b {both}"] = A, b
    root, C = fit.compute_inverse_root(A, 1e-3), np.diag(np.sqrt(fit.GAMMA_0))
    far = np.array([1.0] * 6 + [0.1] * 3)
    results |= {
        "inverse_root": root,
        "least informative observation": fit.find_least_informative_observation(fitted, N, root),
        "decay": gradient_flow.integrate_gradient_flow(A, b, 0.5 * a, C, 1.0),
        "by_series": C @ gradient_flow.integrate_by_series(C @ A @ C, C @ b, 1e-3),
        "by_modes": C @ gradient_flow.integrate_by_eigenvectors(C @ A @ C, C @ b, 1.0),
        "limited step": fit.limit_step_by_depth(0 * a, far, rows, N, shaft),
        "markers_jacobian": fit.compute_markers_jacobian(a, P, shaft),
        "jacobian_at": fit.compute_jacobian_at_points(a, P, scene.points, o_c, shaft),
        "predict": fit.predict_markers(a, P, shaft),
    }
    for rate in (0.0, 20.0):
        memory, rule = fit.ProjectionMemory(np.zeros((7, 7)), 0, np.zeros(9)), (rate, 1e-7, True)
        for row in rows:
            points = row[3:].reshape(2, 2)
            memory = fit.update_from_frame(
                memory, row[:3], points, o_c, 0.1, fit.ProjectionKernel(*rule), shaft
            )
        results[f"observations {rate}"] = memory.observations[: memory.observation_count]
        results[f"a_hat {rate}"] = memory.a_hat
    full = EstimatorMemory(np.ones((7, 3)), memory)
    results["no memory"] = empty_with_lines(fit.ProjectionKernel(*rule), full).memory.a_hat
    return results


def run_ball_fits(scene):
    """Return results of the estimator from positions and sizes."""
    from rcmservo.estimation import affine, ball_size_fit
    from rcmservo.geometry import tool

    shaft, memory = tool.ToolStruct(0, SPACING), ball_size_fit.make_initial_ball_fits()
    for row in scene.rows:
        points, sizes = row[3:].reshape(2, 2), 1e3 / np.array([200.0 - row[0], 190.0 - row[0]])
        memory = affine.update_both_fits(memory, row[:3], points, sizes, 2.0, shaft)
    p1, rcm = scene.positions[0], affine.estimate_imaged_rcm(memory)
    return {
        "sized C": np.stack([memory[k]["C"] for k in range(2)]),
        "sized J": affine.compute_fitted_features_jacobian(
            memory, p1, scene.points, scene.o_c, shaft
        ),
        "sizes motion": affine.compute_sizes_jacobian(memory, p1, shaft),
        "sized markers": affine.predict_markers(memory, p1, shaft),
        "sized rcm": rcm[0],
        "sized rcm covariance": rcm[1],
        "sized position": ball_size_fit.locate_ball(memory[0], scene.points[0], 6.0)[0],
    }


def run_projection_fit(scene):
    """Return results of the projection fit to eight frames, and of the estimator made of it."""
    from rcmservo.estimation import camera_fit, camera_fit_prediction, dlt
    from rcmservo.geometry import tool
    from rcmservo.servo.update_estimate import empty_memory

    shaft, memory, p1 = (
        tool.ToolStruct(0, SPACING),
        camera_fit.make_initial_fit().rows,
        scene.positions[0],
    )
    for row in scene.rows:
        camera_fit.update_fit(memory[0], row[:3], row[3:].reshape(2, 2), shaft)
    v, fit_rows = memory[0], camera_fit.ProjectionFit(memory)
    position, covariance = camera_fit_prediction.predict_image(v, P)
    results = {
        "A of the fit": fit_rows.A,
        "g of the fit": fit_rows.g,
        "noise of the fit": fit_rows.noise_variance,
        "offset of the fit": fit_rows.offset,
        "image": position,
        "covariance": covariance,
        "predicted markers": camera_fit_prediction.predict_markers(v, p1, shaft),
        "markers": camera_fit_prediction.filter_markers(v, p1, shaft),
        "motion": camera_fit_prediction.compute_markers_jacobian(v, p1, shaft),
        "J of the fit": camera_fit_prediction.compute_fitted_features_jacobian(
            v, p1, scene.points, scene.o_c, shaft
        ),
        "squared dilution": camera_fit_prediction.compute_squared_dilution(v, p1, shaft),
        "pose deviation": camera_fit_prediction.compute_pose_deviation(v, p1, shaft),
        "without marker 2": camera_fit_prediction.compute_deviation_without_marker(v, p1, 1, shaft),
        "marker order": camera_fit_prediction.compute_marker_order_score(v),
        "nothing stored": empty_memory(dlt.DltKernel(), ()),
    }
    results |= run_planning(v, scene, shaft)
    camera_fit.reset_fit(v)
    empty = camera_fit.ProjectionFit(memory)
    numbers = {field.name for field in empty.fields} - {"work"}
    return results | {f"reset {name}": getattr(empty, name) for name in numbers}


def run_planning(v, scene, shaft):
    """Return the uncertainty of the direction to the target, and the next corner."""
    from rcmservo.control import exploration, exploration_planning
    from rcmservo.geometry import kinematics
    from rcmservo.numerics.structs import to_row

    x, p1, limits = (
        to_row(exploration.Exploration())[0],
        scene.positions[0],
        ((-4.0,) * 3, (200.0,) * 3),
    )
    rcm = kinematics.RcmStruct(0, 2.0, *limits)
    q = kinematics.compute_joints(rcm, p1)
    state = exploration.ExplorationState.of(
        start_joints=q, next_corner=q, sides=[0.03, 0.03, 2.5], visited_corners=3
    )
    exploration_planning.plan_corner(state.rows[0], v, rcm, shaft, q, scene.target, 9.0)
    assert not np.array_equal(state.next_corner, q)
    return {
        "path error": exploration_planning.compute_path_error(v, p1, scene.target, shaft),
        "direction is known": exploration_planning.direction_is_known(
            v, p1, scene.target, shaft, x
        ),
        "planned corner": state.next_corner,
    }


def run_drift_checks(scene):
    """Return results of the checks on images with offset markers, and on a frozen image."""
    from conftest import make_tick_facts
    from rcmservo.control import exploration
    from rcmservo.estimation import camera_fit
    from rcmservo.geometry import tool
    from rcmservo.numerics.structs import to_row
    from rcmservo.safety import innovation, monitor_state
    from rcmservo.safety.checks import devices, drift, repeated_frames
    from rcmservo.safety.thresholds import Thresholds

    shaft, fit_rows, t = (
        tool.ToolStruct(0, SPACING),
        camera_fit.make_initial_fit(),
        to_row(Thresholds())[0],
    )
    v, results = fit_rows.rows[0], {}
    for row in scene.rows:
        camera_fit.update_fit(v, row[:3], row[3:].reshape(2, 2), shaft)
    for name, off in {
        "none": np.zeros((2, 2)),
        "both": np.full((2, 2), 9.0),
        "one": np.array([[0.0, 0.0], [20.0, -9.0]]),
        "crossed": scene.points[::-1] - scene.points,
    }.items():
        w = monitor_state.initial_monitor_state()
        for step in range(2 * Thresholds.drift_frames):
            moves = 1e-6 * step if name != "both" else 0.0
            p1 = scene.positions[step % 2]
            points = scene.points + off + moves
            repeated_frames.detect_repeated_frame(w.rows[0], v, True, p1, points, shaft, t)
            drift.update_drift(w.rows[0], v, p1, points, shaft, step > 30, t)
        state = exploration.ExplorationState.of(is_done=True)
        facts = make_tick_facts(monitor=w, exploration_state=state, thresholds=t)
        detectors = (
            repeated_frames.image_is_frozen,
            drift.one_marker_deviates,
            drift.markers_drift,
        )
        detections = [detects(facts) for detects in detectors]
        results[f"drift of {name}"] = [*w.mean_residual.ravel(), *w.drift_px, *detections]
        positions = np.stack([scene.points, scene.points + off])
        results[f"stuck by {name}"] = [
            drift.detect_still_markers(w.rows[0], p1, points, True, t)
            for p1, points in zip(scene.positions, positions, strict=False)
        ]
        results[f"deviating by {name}"] = innovation.find_deviating_markers(
            v, scene.positions[0], scene.points + off, scene.target, shaft, t
        )
    old = monitor_state.ObservationRow.of(now=10**9)
    facts = make_tick_facts(
        observation=old, monitor=monitor_state.initial_monitor_state(), thresholds=t
    )
    results["old frame"] = devices.frames_stopped(facts), devices.frame_times_are_invalid(facts)
    return results


def run_jacobian_updates(scene):
    """Return results of the flow rule, Broyden's update and the other displacement estimators."""
    from rcmservo.estimation import correntropy, displacement, flow_rule, kalman, rls

    J, delta_p, delta_y = 0.5 * scene.J, np.array([1.0, 2.0, -1.0]), np.array([0.1, 5.0, -3.0])
    p1, p2, both = scene.positions[0], scene.positions[1], (scene.points, scene.target)
    results = {
        "flow rule": flow_rule.integrate_flow_rule(J, delta_p, delta_y, 0.02, 0.01),
        "broyden": displacement.apply_rank_one_update(J, delta_p, delta_y, 1.0),
    }
    P, rule = np.diag([1.0, 2.0, 3.0]), (delta_p, delta_y)
    update_results = {
        "displacement": displacement.measure_displacement(p1, both[0], p2, both[1], scene.o_c),
        "rls": rls.apply_rls_update(J, P, *rule, 0.9),
        "kalman": kalman.apply_kalman_update(J, P, *rule, 0.01, 0.05),
        "correntropy": correntropy.apply_correntropy_update(
            J, np.stack([P, P, P]), *rule, 0.01, 0.05, 3.0
        ),
    }
    return results | {
        f"{name} {k}": part for name, of in update_results.items() for k, part in enumerate(of)
    }


def run_controller_and_gate(scene):
    """Return results of the innovation checks, the law and the gate."""
    from rcmservo.control import saturated_controller
    from rcmservo.control.exploration import ExplorationState
    from rcmservo.geometry import kinematics
    from rcmservo.numerics.structs import to_row
    from rcmservo.safety import gate, innovation, monitor_state
    from rcmservo.safety.thresholds import Thresholds

    J, delta, o_c, both = scene.J, scene.delta, scene.o_c, (scene.target, scene.points)
    sample = monitor_state.ObservationRow.of(
        q=np.full(3, 0.1), applied=np.full(3, 0.5), q_time=10_000_000
    )
    monitor = monitor_state.MonitorState.of(observation=sample, predicted_rates=np.ones((4, 3)))
    results = {
        "jumps": innovation.find_jumps(*both, 0.5, 1.0, 20.0),
        "deviation from estimate": innovation.compare_with_estimate(
            *both, o_c, J, scene.step, 0.2, 0.75
        ),
    }
    drives, limits = ExplorationState.of(lag=0.025).rows[0], to_row(Thresholds())[0]
    monitor_state.predict_joints(monitor.rows[0], drives, True, limits)
    predicted = monitor.predicted_joints.ravel(), monitor.predicted_rates.ravel()
    results["predicted joints"] = np.concatenate(predicted)
    b = np.full(3, 0.1)
    for follows_paper in (False, True):
        output, error = saturated_controller.compute_controller_output(
            J, delta, b, follows_paper, 2.0, 150.0, 40.0
        )
        results[f"controller output {follows_paper}"] = [
            *output.v,
            output.condition,
            output.reducible_fraction,
            error,
        ]
        results[f"gradient {follows_paper}"] = saturated_controller.compute_potential_gradient(
            delta, b, follows_paper
        )
        results[f"potential {follows_paper}"] = saturated_controller.compute_potential(
            delta, b, follows_paper
        )
    damped = np.diag([1.0, 0.2, 0.01])
    results["damped"] = saturated_controller.solve_velocity(damped, np.ones(3), 2.0, 150.0, 1e6).v
    requested, last = np.array([0.9, -0.4, 70.0]), np.array([0.85, -0.4, 40.0])
    rcm = kinematics.RcmStruct(0, 0.0, (-1.0, -1.0, 40.0), (1.0, 1.0, 91.0))
    bounds = to_row(gate.Gate((1.0, 1.0, 80.0), (8.0, 8.0, 500.0), 0.05))[0]
    for joint_margin in (0.0, 0.9):
        near = np.array([0.4, -0.3, 90.0])
        rates = last.copy()
        results[f"finite {joint_margin}"] = gate.limit_rates(
            requested, rates, near, rcm, bounds, 0.01, joint_margin
        )
        results[f"within {joint_margin}"] = rates
    return results


def run_resets():
    """Return modes and the resets that they cause."""
    from rcmservo.control.exploration import ExplorationState
    from rcmservo.numerics.structs import to_row
    from rcmservo.safety import gate, state_machine
    from rcmservo.safety.causes import Cause
    from rcmservo.safety.monitor_state import MonitorState
    from rcmservo.safety.state_machine import PHASES, REQUESTS, ModeStruct, TransitionInputs
    from rcmservo.safety.thresholds import Thresholds
    from rcmservo.servo import apply_mode
    from rcmservo.servo.state import (
        Decision,
        Estimate,
        StoredState,
        reset_estimation_except_markers,
    )

    results, t = {}, to_row(Thresholds())[0]
    causes = Cause.AGEING, Cause.STALE, Cause.CAMERA_MOVED, Cause.ARM_SILENT
    for phase in range(len(PHASES)):
        for request in range(len(REQUESTS)):
            d = ModeStruct.of(phase=phase, cause=Cause.LATE.code, accepted_frames=20, since=1)
            for cause_bits in (0, *(cause.bit for cause in causes)):
                signs = TransitionInputs(True, True, True, phase > 1)
                state_machine.advance_mode(d.rows[0], cause_bits, signs, request, 5, t)
            results[f"mode {phase} {request}"] = [
                d.phase,
                d.cause,
                d.since,
                d.accepted_frames,
                d.action,
            ]
    positions = {"p1": P, "points": np.array([[300.0, 200.0], [250.0, 150.0]]), "o_c": 90.0}
    for name, change in {
        "reset": lambda stored: reset_estimation_except_markers(stored.rows[0]),
        "invalidated": lambda stored: apply_mode.invalidate(
            stored.rows[0], Cause.CAMERA_MOVED.code, 5
        ),
        "failed": lambda stored: apply_mode.enter_not_finite_fault(stored.rows[0], 7),
        "stopped": lambda stored: gate.make_stop_command(
            stored.decision.command.rows[0], 9, gate.Gate().struct_row[0]
        ),
    }.items():
        stored = StoredState.of(
            monitor=MonitorState.of(accepted_frame=3, rejected_frames=2),
            estimate=Estimate.of(J_hat=1.0, exposure=4, **positions),
            exploration_state=ExplorationState.of(is_done=True, visited_corners=4),
            decision=Decision.of(command=gate.CommandStruct.of(number=5, rates=1.0, enabled=True)),
        )
        answer = change(stored)
        d = stored.decision
        rows = stored.monitor, stored.estimate, stored.exploration_state, d, d.mode, d.command
        results[name] = np.concatenate(
            [
                np.ravel(getattr(row, field.name))
                for row in rows
                for field in row.fields
                if field.name not in ("mode", "command", "observation")
            ]
        )
        results[f"result of {name}"] = float(answer or 0.0)
    return results


def run_response_measurement():
    """Return gains and lag of the drives from a few measurements."""
    from rcmservo.control import drive_response
    from rcmservo.control.exploration import ExplorationState

    state, max_rates = ExplorationState.of(), np.array([1.0, 1.0, 80.0])
    drive_response.start_response_measurement(state.rows[0])
    for k in range(40):
        q, applied = 0.01 * np.sin(0.3 * k) * max_rates, 0.3 * np.cos(0.3 * k + 0.5) * max_rates
        drive_response.add_response_reading(state.rows[0], q, 10_000_000 * k, applied)
    drive_response.finish_response_measurement(state.rows[0], max_rates)
    assert state.lag > 0.0
    return {
        "lag": state.lag,
        "gains": state.gains,
        "selected lag": drive_response.select_lag(state.rows[0], 0.0),
        "lag so far": drive_response.estimate_lag_so_far(state.rows[0], 0.0, max_rates),
    }


def run_functions():
    """Return the results of every compiled function of the core on a few inputs, by name."""
    scene = make_scene()
    results = (
        run_geometry()
        | run_imaging(scene)
        | run_projection_rule(scene)
        | run_projection_fit(scene)
        | run_drift_checks(scene)
    )
    results |= (
        run_ball_fits(scene)
        | run_jacobian_updates(scene)
        | run_controller_and_gate(scene)
        | run_resets()
        | run_response_measurement()
    )
    return {name: np.asarray(value, dtype=float) for name, value in results.items()}


def run_steps():
    """Return results of servo steps on exact images of a tool that follows its commands.

    The steps explore first and then servo.
    """
    from rcmservo.control.exploration import Exploration
    from rcmservo.control.saturated_controller import SaturatedController
    from rcmservo.estimation.affine import AffineEstimator
    from rcmservo.estimation.broyden import BroydenEstimator
    from rcmservo.estimation.dlt import DltEstimator
    from rcmservo.estimation.flow_rule import FlowEstimator
    from rcmservo.estimation.kalman import KalmanEstimator
    from rcmservo.estimation.projection_rule import ProjectionEstimator
    from rcmservo.geometry.kinematics import PitchYawRcm
    from rcmservo.geometry.tool import RigidTool, ScaledTool
    from rcmservo.interfaces import Observation, Target
    from rcmservo.safety.causes import Cause
    from rcmservo.safety.state_machine import Phase
    from rcmservo.safety.thresholds import Thresholds
    from rcmservo.servo.servo import Servo

    C, results, rcm = camera(), {}, PitchYawRcm()
    configurations = {
        "fast": (ProjectionEstimator(observations=6), RigidTool(30.0), "srd"),
        "printed": (
            ProjectionEstimator("printed", observations=6, estimator_time=1e3),
            ScaledTool(1.3),
            "srd",
        ),
        "dlt": (DltEstimator(), RigidTool(30.0), "srd"),
        "flow": (FlowEstimator(0.05), RigidTool(30.0), "srd"),
        "broyden": (BroydenEstimator(), RigidTool(30.0), "srd"),
        "kalman": (KalmanEstimator(), RigidTool(30.0), "srd"),
        "points": (DltEstimator(), RigidTool(30.0), "points"),
        "size": (AffineEstimator(), RigidTool(30.0), "size"),
    }
    for name, (estimator, tool, features) in configurations.items():
        exploration = Exploration(leg_time=0.1, tolerance=0.9)
        approach = {"broyden": (0.01, 0.01, 1.0)}.get(name, (0.0, 0.0, 0.0))
        law = SaturatedController(features=features, approach=approach)
        thresholds = Thresholds(max_target_deviation=60.0 if name == "kalman" else 6.0)
        servo = Servo(
            rcm, tool, estimator, law, thresholds=thresholds, exploration=exploration, rate=50.0
        )
        q = rcm.joints(np.array([20.0, -10.0, -100.0]))
        p_d = rcm.position(q + np.array([0.05, -0.04, 6.0]))
        target = Target(pixels(C, p_d), rcm.joints(p_d), sizes=radii(C, p_d))
        state, executed, phases, rates, J, delta = servo.init(), np.zeros(3), [], [], [], []
        for k in range(1, 75):
            time, applied, points = 20_000_000 * k, executed, pixels(C, rcm.position(q))
            if k in (60, 61):  # frames that are rejected
                points = points + 30.0
            sizes = radii(C, rcm.position(q))
            if name == "dlt" and k == 73:  # a target that its joints contradict
                target = replace(target, points=target.points + np.array([[40.0], [0.0]]))
            if name == "kalman" and k == 66:  # image and joints differ by a few mm
                target = replace(target, points=pixels(C, p_d + np.array([0.0, 4.0, 0.0])))
            if name == "size" and k in (66, 67):
                points[0], sizes[0] = np.nan, np.nan
            frame = (k, time, time, q, points)
            observation = Observation(time, q, time, True, applied, *frame, sizes=sizes)
            state = servo.step(state, observation, target)
            executed = state.command.rates
            if name == "points" and 50 <= k < 66:  # a detour, from which the joints lead back
                executed = np.array([0.0, 0.0, 60.0])
            q = q + 0.02 * executed
            phases.append(list(Phase).index(state.phase))
            rates.append(state.command.rates)
            if k > 24:  # before, weakly observed directions amplify rounding
                J.append(state.J_hat / np.array([0.17, 10.0, 10.0])[:, None])
            delta.append(state.delta)
        results |= {
            f"{name} rates": rates,
            f"{name} J": J,
            f"{name} delta": delta,
            f"{name} phase": phases,
            f"{name} implausible": state.cause is Cause.IMPLAUSIBLE,
        }
    return {name: np.asarray(value, dtype=float) for name, value in results.items()}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return the results of a process without the compiler."""
    path = tmp_path_factory.mktemp("oracle") / "plain.npz"
    environment = make_environment(NUMBA_DISABLE_JIT="1")
    subprocess.run([sys.executable, __file__, path], env=environment, check=True)
    with np.load(path) as results:
        return dict(results)


def agree(compiled, plain, names):
    assert names
    for name in names:
        result, expected = compiled[name], plain[name]
        assert result.shape == expected.shape, name
        finite = np.isfinite(expected)
        assert np.array_equal(finite, np.isfinite(result)), name
        size = np.abs(expected[finite]).max(initial=1e-3)
        assert np.all(np.abs(result[finite] - expected[finite]) <= TOLERANCE * size), name


def test_every_function_gives_the_same_numbers_compiled_and_as_plain_python(plain):
    results = run_functions()
    agree(results, plain, list(results))


def test_a_servo_takes_the_same_steps_compiled_and_as_plain_python(plain):
    results = run_steps()
    agree(results, plain, list(results))
    assert {2.0, 3.0} <= set(results["fast phase"]), "it explores and servoes"
    assert results["dlt implausible"] and not results["flow implausible"]
    assert np.abs(results["fast rates"]).max() > 0.1


def test_the_oracle_calls_every_compiled_function_of_the_core(plain):
    """A function that is not called directly is called by another one."""
    called, core = set(plain["called functions"]), find_compiled_functions()
    assert len(core) > 60
    assert [name for name in core if name not in called] == []


def list_called_functions(run):
    """Return the results of `run`, and module and name of every function that it called."""
    called = set()

    def watch(frame, event, _):
        if event == "call":
            called.add((frame.f_globals.get("__name__", ""), frame.f_code.co_name))

    sys.setprofile(watch)
    try:
        results = run()
    finally:
        sys.setprofile(None)
    return results, sorted(".".join(name) for name in called)


if __name__ == "__main__":
    found, names = list_called_functions(lambda: run_functions() | run_steps())
    np.savez(sys.argv[1], **found, **{"called functions": np.array(names)})
