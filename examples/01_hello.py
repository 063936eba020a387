"""Hello world: a simulated arm returns to a taught pose, with an uncalibrated camera."""

import rcmservo as rs

rig = rs.sim.Rig(seed=0)  # simulation; real devices implement the same Protocols
plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(), rig.clock)
servo = rs.Servo(
    mechanism=rs.SphericalRcm(),  # kinematics of the arm
    tool=rs.RigidTool(spacing=30.0),
    estimator=rs.DltEstimator(),  # Ĵ of eq. (15) from a projection fitted to all frames
    controller=rs.SaturatedController(gain=6.0),  # eq. (31)-(32)
)
rig.move_to_target()
target = rs.teach(plant)  # teaching by showing
rig.move_to_start()
plant.reset()  # discard observations, because the tool was moved by hand

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
