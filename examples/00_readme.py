import numpy as np

import rcmservo as rs

rig = rs.sim.Rig(seed=0)  # a simulated arm and camera, drawn from the seed
plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)
servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))  # mm between the balls
rig.move_to_target()  # the simulated operator brings the tool to the target
target = rs.teach(plant)
_, p2_d = rig.truth.markers(rig.clock.now())  # true position of ball 2, mm
rig.move_to_start()
ticks = list(rs.servo_ticks(plant, servo, target, duration=5.0))
_, p2 = rig.truth.markers(rig.clock.now())
print(f"{ticks[-1].state.phase.value}: {np.linalg.norm(p2 - p2_d):.3f} mm from the target")
