"""Hexapod: a walking robot on MuJoCo, as Hexapod-v0 and HexapodCommand-v0.

Its action is a residual on a tripod gait; every episode draws new ground, body parameters and
pushes.

env.py           Hexapod-v0: walk straight ahead over rough ground
command.py       HexapodCommand-v0: follow a commanded forward speed and turn rate
robot.py         MuJoCo model (hexapod.xml), servos and sensors
terrain.py       height field of random bumps
gait.py          central pattern generator
disturbances.py  random body parameters and pushes
observation.py   names, order and scales of the 77 observed values
reward.py        reward terms of both tasks
camera.py        off-screen frames and a window
"""
