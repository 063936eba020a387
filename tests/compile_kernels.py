"""Compile the kernels that most tests use, in two processes, before the tests' workers start.

    python tests/compile_kernels.py

Two workers that meet a cold cache compile the same kernels at the same time. Here each process
compiles a half that the other does not need early, and leaves it in the cache on disk.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent)]


def compile_servo() -> None:
    """Compile the default servo, the simulation of studies around it, and the other estimators."""
    import rcmservo as rs
    from conftest import ESTIMATORS, make_laboratory
    from rcmservo.study.compiled_engine import CompiledEngine

    lab = make_laboratory()
    servo = lab.servo(estimator=ESTIMATORS["dlt"])
    servo.warm_up()
    CompiledEngine(servo, duration=0.1, teaching_frames=1).run(0)
    for estimator in [*ESTIMATORS.values(), rs.AffineEstimator()]:
        if not isinstance(estimator, rs.ProjectionEstimator):
            lab.servo(estimator=estimator).warm_up()


def compile_images() -> None:
    """Compile rendering, tracking and teaching, then the projection estimator.

    The projection estimator shares the fewest kernels with `compile_servo`.
    """
    import rcmservo as rs
    from conftest import ESTIMATORS, TOOLS, make_laboratory
    from rcmservo.study.compiled_engine import CompiledEngine

    rig = rs.sim.Rig()
    rs.teach(rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock), 1)
    lab = make_laboratory()
    servo = lab.servo(estimator=ESTIMATORS["fast"])
    servo.warm_up()
    CompiledEngine(servo, duration=0.1, teaching_frames=1).run(0)
    lab.servo(estimator=ESTIMATORS["fast"], tool=TOOLS["scaled"]).warm_up()


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as processes:
        for done in [processes.submit(compile_servo), processes.submit(compile_images)]:
            done.result()
