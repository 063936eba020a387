"""Comparison of gains in the same scenes, with hundreds of simulated closed loops per minute.

python examples/03_many_runs.py [SCENES]
"""

import sys

import rcmservo as rs


def make_servo(gain: float) -> rs.Servo:
    return rs.Servo(controller=rs.SaturatedController(gain=gain))


if __name__ == "__main__":
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    study = rs.compare({f"gain {g}": make_servo(g) for g in (2, 6, 12)}, scenes)
    print(study)
    study.worst("gain 12").show()
