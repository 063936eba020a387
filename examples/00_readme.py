import numpy as np

import rcmservo as rs

rig = rs.sim.Rig(seed=0)  # a simulated arm and camera, drawn from the seed
plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)
servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))  # spacing of the markers, mm
rig.show_target()
target, p2_d = rs.teach(plant), rig.truth.markers(rig.clock.now())[1]
rig.go_home()
ticks = list(rs.run(plant, servo, target, duration=5.0))
error = np.linalg.norm(rig.truth.markers(rig.clock.now())[1] - p2_d)
print(f"{ticks[-1].state.phase.value}: marker 2 ends {error:.3f} mm from where it was taught")
