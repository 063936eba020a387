"""Runs with a port that moves with the breath: named while teaching or at a stop, or harmless.

    python benchmarks/breathing_port.py [--runs 100] [--first 8000] [--frames 300]

Each run has its own scene, a simulated arm whose RCM moves by an amplitude in mm with a period of
4 s, and a camera of points with 0.3 px. The arms without such a motion are taught a target only.

    refused    the target is refused, and the sentence names the motion
    stopped    the run stops, and the sentence names the motion
    within     it ends within 1 mm and the amplitude of the motion
    silent     it is refused or stops without naming the motion, or ends farther off
    suspected  the motion is named although there is none
"""

import argparse
from collections import Counter
from functools import partial
from multiprocessing import Pool

import numpy as np

import rcmservo as rs
from rcmservo.config.rig_file import RigDescription
from rcmservo.loop.teach import TeachingFailed
from rcmservo.sim import Imperfections, RigSettings
from rcmservo.sim.imperfections import ARMS
from rcmservo.sim.rig_file import read_rig_settings

AMPLITUDES_MM = 1.0, 2.0, 5.0
DURATION_S = 8.0
NAME = "port move with the breath"


def make_rig(arm: str | float, seed: int) -> rs.sim.Rig:
    if isinstance(arm, str):
        settings = read_rig_settings(RigDescription(), arm)
    else:
        settings = RigSettings(imperfections=Imperfections(port_motion=arm))
    return rs.sim.Rig(seed, settings, pictures=False)


def run(arm: str | float, frames: int, seed: int) -> str:
    """Return how a run ends."""
    rig = make_rig(arm, seed)
    try:
        target = rig.teach(frames)
    except TeachingFailed as error:
        return "refused" if NAME in str(error) else "silent"
    if isinstance(arm, str):
        return "suspected" if target.swing_text else "quiet"
    rig.plant.reset()
    rig.plant.enable()
    servo = rs.Servo(rig.mechanism, rig.tool)
    for tick in rs.servo_ticks(rig.plant, servo, target, DURATION_S):
        if tick.state.phase in (rs.Phase.PAUSED, rs.Phase.FAULT):
            return "stopped" if NAME in tick.state.text else "silent"
    p2, taught = rig.truth.markers(rig.clock.now())[1], rig.truth.tool_body.points(rig.scene.target)
    return "within" if np.linalg.norm(p2 - taught[1]) <= 1.0 + arm else "silent"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=8000)
    parser.add_argument("--frames", type=int, default=300)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.runs)
    with Pool(2) as pool:
        for arm in (*ARMS, *AMPLITUDES_MM):
            ends = Counter(pool.map(partial(run, arm, options.frames), seeds, chunksize=5))
            name = arm if isinstance(arm, str) else f"{arm:g} mm"
            print(f"{name:6}", ", ".join(f"{end} {n}" for end, n in ends.most_common()), flush=True)


if __name__ == "__main__":
    main()
