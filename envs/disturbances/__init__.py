"""Disturbances: what goes wrong in a world while a policy acts, at levels 1 to 3 or by a number.

`spikedeploy.envs.make(name, disturb=["noise:2", "payload=0.4"])` puts them on an environment, as
`--disturb` does. They are drawn per episode from its seed, apart from the draws of the environment,
which stay what they were. Environments of other people have those of observations and commands. A
new kind is a Kind and a line in DISTURBANCES.

kind       what a kind of disturbance is: meaning, unit, levels in each world
disturbed  requests read, and the environment with them
seeded     wrappers with draws of their own
scales     the unit of noise and bias
sensors    noise, bias and dropout of observations
delays     observations and commands that are late, commands that are lost
body       weak motors, payload, slope, friction, pushes
limbs      joints and legs without power
karts      noise and dropout of the LIDAR, grip
"""

_HERE = "spikedeploy.envs.disturbances"
DISTURBANCES: dict[str, str] = {
    "noise": f"{_HERE}.sensors:NOISE",
    "bias": f"{_HERE}.sensors:BIAS",
    "dropout": f"{_HERE}.sensors:DROPOUT",
    "delay": f"{_HERE}.delays:DELAY",
    "command-delay": f"{_HERE}.delays:COMMAND_DELAY",
    "command-loss": f"{_HERE}.delays:COMMAND_LOSS",
    "weakness": f"{_HERE}.body:WEAKNESS",
    "dead-joint": f"{_HERE}.limbs:DEAD_JOINT",
    "dead-leg": f"{_HERE}.limbs:DEAD_LEG",
    "payload": f"{_HERE}.body:PAYLOAD",
    "slope": f"{_HERE}.body:SLOPE",
    "friction": f"{_HERE}.body:FRICTION",
    "pushes": f"{_HERE}.body:PUSHES",
    "lidar-noise": f"{_HERE}.karts:LIDAR_NOISE",
    "lidar-dropout": f"{_HERE}.karts:LIDAR_DROPOUT",
    "grip": f"{_HERE}.karts:GRIP",
}
