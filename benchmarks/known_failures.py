"""Failure with slow drives, as README reports it.

    python benchmarks/known_failures.py [COUNT]

Every drive follows its command with a time constant of 0.25 s: 15 s runs that stop. A wrong target,
such as one of a mirrored image, is a row of unnoticed.py.
"""

import sys

import rcmservo as rs
from rcmservo.sim.arm import Drive

LAG_S = 0.25


def main(count: int) -> None:
    settings = rs.sim.RigSettings(drive=Drive(lag=LAG_S))
    servo = rs.Servo(settings.mechanism, settings.tool)
    rows = rs.compare({"default": servo}, scenes=count, settings=settings).rows
    stopped = sum(row.stops > 0 for row in rows)
    print(f"lag of {1e3 * LAG_S:g} ms: {stopped} of {count} stop")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
