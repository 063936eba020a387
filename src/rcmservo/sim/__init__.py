"""Simulated laboratory: arm, camera, tool, scene and disturbances.

The true state stays inside this package; no servo can read it. A `Rig` is one laboratory that
follows from a seed. Its devices make a `Plant`::

    rig = rs.sim.Rig(seed=0)
    plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)

With ``Rig(seed, pictures=False)`` the frames hold the markers' pixels instead of an image, and the
tracker is ``rs.tracking.PointMarkers()``. ``rig.move_to_target()`` and ``rig.move_to_start()``
place the tool. ``rig.truth`` has the true state, with which a run is evaluated.

``Rig(disturbances=[Disturbance.parse("occlusion:at=5,for=0.5")])`` adds faults. Their times count
from ``rig.begin()``, before which none acts. The kinds are, by the part that they disturb:

- view: occlusion, swap, decoy, freeze, nan_points (only with ``pictures=False``)
- camera: camera_pan, camera_roll, camera_dolly, camera_zoom, relocate
- frames: frame_drop, latency, frame_order, corrupt, camera_clock
- arm: gain, creep, encoder, encoder_nan, arm_silent, arm_clock, drive_off
- computer: stall, jitter, kill, disk_full

``rcmservo run --disturb help`` lists the parameters of each kind that a camera with images can
have.
"""

from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.disturbances import Disturbance, Killed
from rcmservo.sim.rendering import Appearance
from rcmservo.sim.rig import Rig, RigSettings
from rcmservo.sim.scene import SceneSettings

__all__ = [
    "Appearance",
    "Disturbance",
    "Drive",
    "Killed",
    "Rig",
    "RigSettings",
    "SceneSettings",
    "Timing",
]
