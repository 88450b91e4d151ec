"""Hexapod: a walking robot on MuJoCo, as Hexapod-v0 and HexapodCommand-v0.

Its action is a residual on a tripod gait; every episode draws new
ground, body parameters and pushes.

env.py      Hexapod-v0: walk straight ahead; the 77 observed values, the reward, random bodies
command.py  HexapodCommand-v0: follow a commanded forward speed and turn rate
robot.py    MuJoCo model (hexapod.xml), servos, sensors, gait, height field of random bumps
camera.py   off-screen frames
"""
