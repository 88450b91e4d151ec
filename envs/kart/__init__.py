"""Karts: KartGrid-v0, KartGazebo-v0 and KartSteer-v0 race through the gates of a track.

Physics on pymunk, observation by LIDAR; the preset "classic" reproduces kart-simulator.

env.py          KartEnv: episode, observation and reward, shared by all karts
grid.py         KartGrid-v0: pushed up, down, left and right
gazebo.py       KartGazebo-v0: drives forward or turns on the spot
steer.py        KartSteer-v0: throttle, brake and steering
world.py        physics of one kart on one track, and the state of a kart
lidar.py        distances to the walls along rays
observation.py  named components of the observation
reward.py       reward terms and weights
stall.py        ends episodes without progress
options.py      checks of the options
track.py        a track: walls, gates and a start
track_file.py   track files, read and checked; tracks/*.json are the shipped ones
track_rules.py  checks that a track can be driven
corridor.py     random corridors
gap.py          a scripted driver that follows the gap
scene.py        a track scaled to a surface
picture.py      pictures of a kart on its track
"""
