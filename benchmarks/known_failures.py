"""Failures in two situations, as README reports them.

    python benchmarks/known_failures.py [COUNT]

mirrored: the image is mirrored after the target was taught (a setting of many cameras). Point
          camera, 8 s, without an operator: runs whose true error grows by more than 5 mm.
lag:      every drive follows its command with a time constant of 80 ms. 15 s: runs that stop.
"""

import sys
from dataclasses import replace

import numpy as np

import rcmservo as rs
from rcmservo.sim.arm import Drive
from rcmservo.tracking import PointMarkers

GROWN_MM = 5.0
LAG_S = 0.08


def growth_mm(seed: int) -> float:
    """Growth of the true error of marker 2 (mm) in a run whose image is mirrored after teaching."""
    rig = rs.sim.Rig(seed, pictures=False)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = rs.Servo(rig.settings.mechanism, tool=rig.settings.tool)
    rig.move_to_target()
    target, p2_d = rs.teach(plant), rig.truth.markers(rig.clock.now())[1]
    rig.go_home()
    state, errors = servo.init(), []
    plant.reset()
    plant.enable()
    for _ in rs.ticks(plant.clock, servo.rate, 8.0):
        observation = plant.read()
        u, v = observation.points[:, 0], observation.points[:, 1]
        points = np.column_stack([rig.settings.width - 1 - u, v])
        state = servo.step(state, replace(observation, points=points), target)
        plant.send(state.command)
        errors.append(float(np.linalg.norm(rig.truth.markers(rig.clock.now())[1] - p2_d)))
    return max(errors) - errors[0]


def main(count: int) -> None:
    growth = np.array([growth_mm(seed) for seed in range(count)])
    grown = f"{(growth > GROWN_MM).sum()} of {count} grow by more than {GROWN_MM:g} mm"
    print(f"mirrored: {grown}, at most {growth.max():.0f} mm", flush=True)
    settings = rs.sim.RigSettings(drive=Drive(lag=LAG_S))
    servo = rs.Servo(settings.mechanism, settings.tool)
    rows = rs.compare({"default": servo}, scenes=count, settings=settings).rows
    stopped = sum(row.stops > 0 for row in rows)
    print(f"lag of {1e3 * LAG_S:g} ms: {stopped} of {count} stop")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
