"""Long runs of the Galil driver: senseless replies, and exchanges with the emulator.

    python benchmarks/galil.py fuzz [COUNT]         sessions, nine of ten with random bytes and one
                                                    with garbled replies (100,000)
    python benchmarks/galil.py exchanges [SECONDS]  of speeds and record, 500 per second (60)

Both print errors at once. The emulator runs in a separate process, on the loopback interface.
"""

import platform
import random
import sys
import time
from contextlib import closing

import numpy as np
from galil_measures import SESSION_STEPS, Emulated, run_with_garbling, run_with_packets

from rcmservo.errors import RcmServoError
from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.hardware.galil.connection import GalilConnection, TcpStream
from rcmservo.hardware.galil.session import GalilSession
from rcmservo.hardware.galil.settings import GalilSettings

RATE = 500.0
"""Exchanges per second."""


def fuzz(count: int) -> int:
    """Run random sessions; return the number of failed ones.

    A session fails if it takes too long, ends without a sentence, or leaves an axis moving or a
    motor on.
    """
    chance, failures, begun = random.Random(0), 0, 0
    for number in range(count):
        try:
            if number % 10:
                noise = [chance.randbytes(chance.randrange(60)) for _ in range(20)]
                passed = run_with_packets(noise, chance.choice(list(SESSION_STEPS))).time < 6.0
            else:
                longest, began, off = run_with_garbling(chance)
                passed, begun = longest < 2.0 and off, begun + began
        except Exception as error:  # any other error is a failure
            print(f"session {number}: {error!r}")
            passed = False
        failures += not passed
        print(f"\r{number + 1} of {count}", end="", file=sys.stderr, flush=True)
    print(f"{count} sessions, {begun} of them moved the axes: {failures} failed")
    return failures


def exchanges(seconds: float) -> int:
    """Exchange speeds and record on an absolute schedule; return the number of late exchanges."""
    with closing(Emulated()) as emulated:
        settings = GalilSettings("127.0.0.1", (50000.0, 50000.0, 500.0), emulated.port)
        streams = [TcpStream("127.0.0.1", emulated.port, 1.0) for _ in range(2)]
        limits = SphericalRcm().limits
        session = GalilSession(*(GalilConnection(one, 0.25) for one in streams), settings, limits)
        session.set_up()
        session.set_position(np.mean(limits.arrays, axis=0))
        session.start()
        took, late, start = [], 0, time.perf_counter()
        try:
            for number in range(round(seconds * RATE)):
                due = start + number / RATE
                time.sleep(max(due - time.perf_counter(), 0.0))
                begin = time.perf_counter()
                rates = 0.05 * np.sin(number / RATE) * np.array([1.0, -1.0, 100.0])
                if not session.exchange(rates).all_on:
                    print(f"after {number} exchanges: {session.off_reason}; restarted")
                    session.start()
                took.append(time.perf_counter() - begin)
                late += begin - due > 1.0 / RATE
        except (KeyboardInterrupt, RcmServoError) as error:
            print(f"ended early: {error!r}")
        whole = time.perf_counter() - start
        session.switch_off()
        for stream in streams:
            stream.close()
    p50, p99 = 1e3 * np.percentile(took, [50, 99])
    print(f"{len(took)} exchanges in {whole:.2f} s: {len(took) / whole:.1f} a second")
    print(f"one takes {p50:.2f} ms (median), {p99:.2f} (99 %), {1e3 * max(took):.2f} (worst)")
    print(f"begun more than a period late: {late} ({late / len(took):.2%})")
    return late


def main() -> None:
    kind = sys.argv[1] if len(sys.argv) > 1 else ""
    print(f"{platform.machine()}, Python {platform.python_version()}")
    if kind == "fuzz":
        sys.exit(fuzz(int(sys.argv[2]) if len(sys.argv) > 2 else 100_000) > 0)
    if kind == "exchanges":
        exchanges(float(sys.argv[2]) if len(sys.argv) > 2 else 60.0)
        return
    sys.exit(__doc__)


if __name__ == "__main__":
    main()
