"""Does a closed loop with the default settings settle, and when: judged by the truth, as noise
leaves single frames outside the tolerance by chance."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rcmservo.guard.states import Cause
from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.features import measured
from rcmservo.method.tool import Tool
from rcmservo.record.verdict import LAST, TOLERANCE
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings
from rcmservo.tracking import PointMarkers


def settle(
    seed: int,
    laboratory: RigSettings,
    duration: float,
    watch: Callable[[Rig, Tick], None],
    known: Tool | None = None,
) -> dict[str, Any]:
    """Servo from home to the scene's target: whether it ``settled``, the ``time`` s when, the
    ``pose`` error mm of marker 2, and the ``cause`` if not. The servo takes its tool as `known`, if
    not as it is."""
    rig = Rig(seed, laboratory, pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.show_target()
    target, goal = teach(plant), rig.body.points(rig.scene.target)[1]
    rig.go_home()
    servo = Servo(laboratory.mechanism, known or laboratory.tool)
    outside, now, cause = 0.0, 0.0, Cause.NONE
    for tick in run(plant, servo, target, duration):
        now, cause = tick.time / 1e9, tick.state.cause
        if not within(rig, tick, target):
            outside = now
        watch(rig, tick)
    settled = cause is Cause.NONE and now - outside >= LAST
    return {
        "settled": settled,
        "time": outside if settled else None,
        "pose": float(np.linalg.norm(rig.truth.markers(rig.clock.now())[1] - goal)),
        "cause": "" if settled else cause.value or "time ran out",
    }


def within(rig: Rig, tick: Tick, target: Target) -> bool:
    """Whether the true features are within the tolerance of the target now."""
    seen = rig.truth.pixels(rig.arm.q_true)
    _, delta = measured(seen, target.points, tick.state.o_c)
    return bool(np.all(np.abs(delta) < TOLERANCE))


def why_not(trials: Sequence[Mapping[str, Any]]) -> str:
    """Why some did not settle, as the end of a sentence."""
    causes = sorted({trial["cause"] for trial in trials if not trial["settled"]})
    return "; not settled: " + ", ".join(causes) if causes else ""
