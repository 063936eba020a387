"""Reduced speed: no command exceeds it, and the run still settles."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import make_laboratory, mark_others_slow
from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.live.unchecked_rig_speed import UNCHECKED_SPEED_SCALE, reduce_speed
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.recording.outcome import OutcomeCollector
from rcmservo.safety.gate import Gate


@pytest.mark.parametrize("seed", mark_others_slow([1, 2]))
def test_a_run_at_reduced_speed_settles_and_no_command_exceeds_its_speed(seed: int) -> None:
    lab = make_laboratory(seed)
    full = lab.servo()
    servo = reduce_speed(full)
    judge, fastest = OutcomeCollector(servo, lab.target), np.zeros(3)
    for tick in servo_ticks(lab.plant, servo, lab.target, 40.0):
        judge.add(tick)
        fastest = np.maximum(fastest, np.abs(tick.state.command.rates))
    result = judge.compute_result()
    assert result.settled, result.cause
    assert (fastest <= UNCHECKED_SPEED_SCALE * np.array(full.gate.speed)).all()
    assert fastest.max() > 0.0


def test_reduced_speed_scales_all_speed_limits_and_nothing_else() -> None:
    full = make_laboratory().servo(
        gate=Gate(speed=(2.0, 1.0, 50.0)),
        controller=SaturatedController(max_speed=30.0, gain=3.0),
        exploration=Exploration(max_time=8.0, max_leg_length=5.0),
    )
    servo = reduce_speed(full, 0.25)
    assert servo.gate == replace(full.gate, speed=(0.5, 0.25, 12.5))
    assert servo.controller == replace(full.controller, max_speed=7.5)
    assert servo.exploration == replace(full.exploration, max_time=32.0)
    assert servo.thresholds == full.thresholds
