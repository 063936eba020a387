"""Nothing compiles while a tool moves: a short warm-up covers every type that a run uses."""

import pickle
import subprocess
import sys
from pathlib import Path

import pytest


def signatures():
    """Return the present signatures of every compiled function that Python calls, by name."""
    from conftest import ESTIMATORS, find_compiled_functions
    from rcmservo.servo.tick import make_compiled_tick

    kernels = [getattr(estimator, "kernel", None) for estimator in ESTIMATORS.values()]
    kinds = {type(kernel) for kernel in kernels if kernel is not None}
    ticks = {f"tick of {kind.__name__}": make_compiled_tick(kind) for kind in kinds}
    assert len(ticks) > 1
    both = find_compiled_functions() | ticks
    return {name: list(function.signatures) for name, function in both.items()}


def check(path):
    """Warm up in a new process and require that all later runs compile nothing."""
    with Path(path).open("rb") as file:
        warm_up, runs = pickle.load(file)
    if warm_up == "method":
        runs[0][0].warm_up()
    else:
        follow(*runs.pop(0))
    before = signatures()
    assert len(before) > 25 and any(before.values()), before
    for run in runs:
        follow(*run)
    new = {name: after for name, after in signatures().items() if after != before[name]}
    assert not new, new


def follow(servo, stream, target):
    state = servo.init()
    for observation in stream:
        state = servo.step(state, observation, target)


def short_run(lab, servo):
    """Return a run with exploration and half a second of servoing."""
    from rcmservo.safety.state_machine import Phase

    stream, count = [], 0
    for observation, state in lab.run(servo, 6.0):
        stream.append(observation)
        count += state.phase is Phase.SERVO
        if count == 50:
            break
    return servo, stream, lab.target


def run_with_losses(lab, servo):
    """Return a run in which one marker is lost for a while and both at the end, until a pause."""
    from conftest import lose_markers
    from rcmservo.safety.state_machine import Phase

    stream, state = [], None
    for seconds, lost in ((5.0, ()), (0.3, (0,)), (0.5, ()), (1.2, (0, 1))):
        for observation, after in lab.run(
            servo, seconds, state, lambda observation, lost=lost: lose_markers(observation, *lost)
        ):
            stream.append(observation)
            state = after
    assert state.phase is Phase.PAUSED
    return servo, stream, lab.target


BOTH = "method", "short run"
"""Methods of warming up: `Servo.warm_up`, and a short run in a user's own loop."""


@pytest.mark.parametrize(
    "estimator,tool,warm_ups",
    [
        ("fast", "rigid", ["method"]),
        pytest.param("fast", "rigid", ["short run"], marks=pytest.mark.slow),
        pytest.param("printed", "scaled", BOTH, marks=pytest.mark.slow),
        pytest.param("flow", "rigid", ["method"], marks=pytest.mark.slow),
        pytest.param("broyden", "rigid", ["method"], marks=pytest.mark.slow),
        pytest.param("nflow", "rigid", ["method"], marks=pytest.mark.slow),
        pytest.param("rls", "rigid", ["method"], marks=pytest.mark.slow),
        pytest.param("kalman", "rigid", ["method"], marks=pytest.mark.slow),
        pytest.param("correntropy", "rigid", ["method"], marks=pytest.mark.slow),
    ],
)
def test_after_the_warm_up_nothing_compiles_in_other_scenes_with_losses_and_pauses(
    tmp_path, estimator, tool, warm_ups
):
    from conftest import ESTIMATORS, TOOLS, make_environment, make_laboratory
    from rcmservo.geometry.kinematics import PitchYawRcm
    from rcmservo.sim import RigSettings

    choice = {"estimator": ESTIMATORS[estimator], "tool": TOOLS[tool]}
    labs = [
        make_laboratory(1),
        make_laboratory(3, RigSettings(mechanism=PitchYawRcm())),
    ]
    first, *others = [(lab, lab.servo(**choice)) for lab in labs]
    runs = [short_run(*first), *(run_with_losses(*other) for other in others)]
    code = "import sys; import test_compile as t; t.check(sys.argv[1])"
    for warm_up in warm_ups:
        with (tmp_path / warm_up).open("wb") as file:
            pickle.dump((warm_up, runs), file)
        command = [sys.executable, "-c", code, str(tmp_path / warm_up)]
        process = subprocess.run(
            command, capture_output=True, text=True, check=False, env=make_environment()
        )
        assert process.returncode == 0, f"{warm_up}: {process.stderr[-2000:]}"
