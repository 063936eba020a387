"""Simulated laboratory: arm, camera, tool, scene and disturbances.

The true state stays inside this package; no servo can read it. A `Rig` is one laboratory that
follows from a seed. Its devices make a `Plant`::

    rig = rs.sim.Rig(seed=0)
    plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)

With ``Rig(seed, pictures=False)`` the frames hold the markers' pixels instead of an image, and the
tracker is ``rs.tracking.PointMarkers()``. ``rig.move_to_target()`` and ``rig.go_home()``
place the tool. `Rig` raises ``NoScene``, a class of `rcmservo.sim.scene`, if it finds no scene.

``rig.truth`` has the true state, with which a run is evaluated. Joints q (3,) are in rad, rad, mm,
times in ns on the clock of the simulation:

- ``joints_at(time)``: joints (3,) within the last second.
- ``markers(time)``: positions p₁, p₂ (2, 3) of both markers in mm within the last second.
- ``pixels(q)``: images (2, 2) of both markers in px at the joints q.
- ``imaged_rcm()``: image o_c (2,) of the RCM in px.
- ``jacobian(q, o_c)``: J = ∂y/∂p₁ (3, 3) in rad/mm, px/mm, px/mm, eq. (15).
- ``jacobian_error(J_hat, q, o_c)``: ‖Ĵ − J‖/‖J‖, with the rows divided by 10°, 10 px, 10 px.

``rig.scene`` has the joints `start` (3,) and `target` (3,) in rad, rad, mm, the joints `path`
(n, 3) between them and `midpoint` (3,), the camera `optics`, the tool `body`, the `tissue`, and the
number `rejected` of infeasible samples.

``Rig(disturbances=[Disturbance.parse("occlusion:at=5,for=0.5")])`` adds faults. Their times count
from ``rig.begin()``, before which none acts. Each kind below stands with its keys and their
defaults. `at` (s) is the start, 0 by default. `for` (s) is the duration, without a default to the
end of the run; for a motion of the camera it is the time that the motion takes. A kind without
`for` happens at once.
"""

from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.disturbances import Disturbance, Killed
from rcmservo.sim.disturbances.disturbance_kinds import document_kinds
from rcmservo.sim.imperfections import Imperfections
from rcmservo.sim.rendering import Appearance
from rcmservo.sim.rig import RigSettings
from rcmservo.sim.rig import SimulatedRig as Rig
from rcmservo.sim.scene import SceneSettings

__all__ = [
    "Appearance",
    "Disturbance",
    "Drive",
    "Imperfections",
    "Killed",
    "Rig",
    "RigSettings",
    "SceneSettings",
    "Timing",
]

__doc__ = f"{__doc__ or ''}\n{document_kinds()}\n"
