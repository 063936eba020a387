"""Long runs of the CRTK driver with an emulated device.

    python benchmarks/crtk.py stream [SECONDS] [--ros1]   account of all commands at 100 Hz (60)
    python benchmarks/crtk.py kill [COUNT] [--ros1]       clients killed during a motion (100)
    python benchmarks/crtk.py servo [SEEDS] [--ros1]      servo runs over topics, with images (5)

ROS 1 needs a master (roscore). The exit code is 0 if all checks pass.
"""

import os
import platform
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
from crtk_measures import NAME, PATIENCE, RunningDevice, client_arm, killed, streamed

from rcmservo.config.rig_file import make_default_markers
from rcmservo.hardware.cameras.settings import TopicSettings
from rcmservo.hardware.cameras.topic import open_topic_camera
from rcmservo.hardware.crtk.arm import CrtkArm
from rcmservo.hardware.crtk.messages import IMAGE_TOPIC
from rcmservo.interfaces import Command, Floats
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig
from rcmservo.sim.tool_body import ToolBody
from rcmservo.tracking import ColourMarkers

DOMAIN = 70
STOP_TIME_MS = 100.0
"""Largest time (ms) that the arm may move after its client was killed."""
MAX_POSE_ERROR_MM = 0.5
"""Largest final pose error (mm) of a run."""
DRIVE_LAG_S = 0.053
"""Lag (s) of the emulated drives behind position commands, as `rig check` measures it."""
DURATION = 15.0
"""Duration (s) of a run."""


def stream(ros: int, seconds: float) -> int:
    """Return the number of commands that the account does not explain."""
    with closing(RunningDevice(ros, DOMAIN)) as device:
        account = streamed(ros, DOMAIN, device, seconds)
    print(account)
    lost = account["commands"] - account["sent"] - account["withheld"] - account["refused"]
    return abs(lost) + abs(account["sent"] - account["heard"]) + (not account["on"])


def kill(ros: int, count: int) -> int:
    """Return the number of trials in which the arm stopped too late."""
    chance, took = random.Random(0), list[float]()
    with closing(RunningDevice(ros, DOMAIN)) as device:
        for number in range(count):
            took.append(killed(ros, DOMAIN, device, chance.uniform(0.7, 1.5)))
            print(f"\r{number + 1} of {count}", end="", file=sys.stderr, flush=True)
    print(f"at rest after {np.median(took):.1f} ms (median), {max(took):.1f} ms (max)")
    return sum(not ms <= STOP_TIME_MS for ms in took)


def servo(ros: int, seeds: int) -> int:
    """Return the number of runs that did not reach the target."""
    failed = 0
    for seed in range(seeds):
        error, phase = servoed(ros, seed)
        print(f"seed {seed}: {error:.2f} mm from the target, {phase}", flush=True)
        failed += not error <= MAX_POSE_ERROR_MM
    return failed


def servoed(ros: int, seed: int) -> tuple[float, str]:
    """Return the final pose error (mm) of a run over topics, and its last phase."""
    rig, clock = Rig(seed, pictures=False), WallClock()
    settings = TopicSettings(IMAGE_TOPIC.under(NAME).name, ros=ros, domain=DOMAIN)
    with (
        emulated(ros, seed),
        closing(client_arm(ros, DOMAIN)) as arm,
        closing(open_topic_camera(settings)) as camera,
        TrackingThread(camera, ColourMarkers(make_default_markers()), clock) as eye,
        apply_realtime_settings(),
    ):
        eye.wait_for(frames=2, timeout_s=10.0)
        plant = Plant(arm, eye, eye, clock)
        brought(arm, clock, rig.scene.target)
        q_taught = arm.measure().q
        target = teach(plant, frames=30)
        brought(arm, clock, rig.scene.start)
        box = Servo(
            rig.settings.mechanism, rig.settings.tool, thresholds=Thresholds(drive_lag=DRIVE_LAG_S)
        )
        phase = ""
        for tick in servo_ticks(plant, box, target, DURATION):
            phase = (
                f"{tick.state.phase.value} {tick.state.mode.cause.text} {arm.off_reason}".strip()
            )
        body = ToolBody(rig.settings.mechanism, rig.settings.tool)
        tips = [body.points(q)[1] for q in (arm.measure().q, q_taught)]
        return float(np.linalg.norm(tips[0] - tips[1])), phase


@contextmanager
def emulated(ros: int, seed: int) -> Iterator[None]:
    """Run the emulated arm and its camera in the context."""
    words = ["emulate", "crtk", "--ros", str(ros), "--domain", str(DOMAIN), "--seed", str(seed)]
    code = "import sys; from rcmservo.__main__ import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as it:
        try:
            assert it.stdout is not None
            if not it.stdout.readline():
                raise RuntimeError("the emulated arm did not start")
            yield
        finally:
            it.send_signal(signal.SIGINT)


def brought(arm: CrtkArm, clock: WallClock, q: Floats) -> None:
    """Move the arm to the joints `q` (3,) and switch it off, in place of a motion by hand."""
    arm.enable()
    for number, _ in enumerate(ticks(clock, 100.0, 10.0)):
        far = q - arm.measure().q
        if (np.abs(far) < [5e-4, 5e-4, 0.05]).all():
            break
        now, most = clock.now(), np.array([0.5, 0.5, 40.0])
        arm.apply(Command(number, now, now + PATIENCE, np.clip(2.0 * far, -most, most), True))
    arm.apply(Command(1 << 40, clock.now(), clock.now() + PATIENCE, np.zeros(3), False))
    for _ in ticks(clock, 100.0, 2.0):
        if not arm.measure().enabled:
            break


def main(arguments: list[str]) -> int:
    """Run the requested measurement; return 1 if a check failed."""
    ros = 1 if "--ros1" in arguments else 2
    what, *rest = [word for word in arguments if word != "--ros1"]
    print(f"{platform.machine()}, {os.cpu_count()} processors, ROS {ros}")
    match what:
        case "stream":
            return stream(ros, float(rest[0]) if rest else 60.0) > 0
        case "kill":
            return kill(ros, int(rest[0]) if rest else 100) > 0
        case "servo":
            return servo(ros, int(rest[0]) if rest else 5) > 0
        case _:
            print(__doc__)
            return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
