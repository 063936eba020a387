"""The loop of a run in the open: read an observation, make one step of the servo, send its command.

`rs.run` does the same, and records and judges the run.
"""

import rcmservo as rs

rig = rs.sim.Rig(seed=0)  # simulation; real devices implement the same Protocols
servo = rs.Servo(
    mechanism=rs.SphericalRcm(),  # kinematics of the arm
    tool=rs.RigidTool(spacing=30.0),
    estimator=rs.DltEstimator(),  # Ĵ of eq. (15) from a projection fitted to all frames
    controller=rs.SaturatedController(gain=6.0),  # eq. (31)-(32)
)
target, plant = rig.teach(), rig.plant

state = servo.init()  # Ĵ = 0: the servo explores first
servo.warm_up()  # compile all kernels before the drive is switched on
plant.enable()
for _ in rs.ticks(plant.clock, rate=100.0, duration=8.0):
    state = servo.step(state, plant.read(), target)
    plant.send(state.command)

print(
    f"{state.phase.value}: Δs = {state.delta[0]:+.4f} rad, Δr = {state.delta[1]:+.2f} px, Δd = "
    f"{state.delta[2]:+.2f} px"
)
