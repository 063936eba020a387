"""Compile the kernels that most tests use, in two processes, before the tests' workers start.

    python tests/compile_kernels.py

Two workers that meet a cold cache compile the same kernels at the same time. Here the processes
share no kernel inside a stage, and find those of the stage before in the cache on disk.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent)]


def compile_servo() -> None:
    """Compile the servo with the default estimator, and the scenes of the tests."""
    from conftest import ESTIMATORS, make_laboratory

    make_laboratory().servo(estimator=ESTIMATORS["dlt"]).warm_up()


def compile_images() -> None:
    """Compile the projection estimator, then rendering, tracking and teaching."""
    import rcmservo as rs
    from conftest import ESTIMATORS, TOOLS

    for tool in TOOLS.values():
        rs.testing.check_estimator(ESTIMATORS["fast"], tool)
    rig = rs.sim.Rig()
    rs.teach(rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock), 1)


def compile_study() -> None:
    """Compile the simulation of studies around the default servo, and the other estimators."""
    import rcmservo as rs
    from conftest import ESTIMATORS, make_laboratory
    from rcmservo.study.compiled_engine import CompiledEngine

    lab = make_laboratory()
    servo = lab.servo(estimator=ESTIMATORS["dlt"])
    CompiledEngine(servo, duration=0.1, teaching_frames=1).run(0)
    for estimator in [*ESTIMATORS.values(), rs.AffineEstimator()]:
        if not isinstance(estimator, rs.ProjectionEstimator):
            lab.servo(estimator=estimator).warm_up()


def compile_projection_study() -> None:
    """Compile the same simulation around the projection estimator."""
    from conftest import ESTIMATORS, TOOLS, make_laboratory
    from rcmservo.study.compiled_engine import CompiledEngine

    lab = make_laboratory()
    servo = lab.servo(estimator=ESTIMATORS["fast"])
    CompiledEngine(servo, duration=0.1, teaching_frames=1).run(0)
    lab.servo(estimator=ESTIMATORS["fast"], tool=TOOLS["scaled"]).warm_up()


STAGES = [(compile_servo, compile_images), (compile_study, compile_projection_study)]

if __name__ == "__main__":
    with ProcessPoolExecutor(2) as processes:
        for stage in STAGES:
            for done in [processes.submit(part) for part in stage]:
                done.result()
