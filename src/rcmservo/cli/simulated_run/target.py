"""Target of a simulated run: taught first, or read from a file."""

import hashlib

import numpy as np

from rcmservo.cli.run_options import RunOptions
from rcmservo.config import target_file
from rcmservo.config.rig_file import RigDescription
from rcmservo.config.target_file import TargetSetup
from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.teach import teach
from rcmservo.sim import Rig


def describe_simulated_setup(rig: Rig, lab: RigDescription) -> TargetSetup:
    """Return the setup for which a target that is taught in simulation is valid.

    The name of its camera is a hash of the camera's optics and pose, so that a target is refused if
    the camera is another one.
    """
    optics = rig.scene.optics
    parameters = np.concatenate(
        [[optics.focal], optics.centre, optics.distortion, optics.rotation.ravel(), optics.position]
    )
    view = hashlib.sha256(np.round(parameters, 6).tobytes()).hexdigest()[:8]
    camera = f"simulation with seed {rig.seed}, view {view}"
    slack, size_px = lab.thresholds.limit_tolerance, (optics.width, optics.height)
    return TargetSetup(camera, *size_px, lab.mechanism, lab.tool, lab.tracking, slack)


def obtain_target(options: RunOptions, rig: Rig, plant: Plant) -> Target:
    """Return the target of the file --target, or teach one and move the tool back to its start."""
    setup = describe_simulated_setup(rig, options.lab)
    if options.target is not None:
        target = target_file.load_target(options.target, setup)
        options.servo.require_target(target)
        return target
    rig.move_to_target()
    target = teach(plant, options.teaching_frames)
    rig.go_home()
    if options.save_target is not None:
        target_file.save_target(options.save_target, target, setup)
    return target
