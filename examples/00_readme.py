import rcmservo as rs

rig = rs.sim.Rig(seed=0)  # a simulated arm and camera, drawn from the seed
target = rig.teach()  # the simulated operator shows the target, then moves the tool away
result = rs.run(rig, rs.Servo(), target, record="runs/first")
print(result)
