"""Karts: KartGrid-v0, KartGazebo-v0 and KartSteer-v0 race through the gates of a track.

Physics on pymunk, observation by LIDAR.

env.py      KartEnv: episode, reward, stalling, options; shared by all karts
karts.py    the three karts: what their actions do
world.py    physics of one kart on one track, and the state of a kart
lidar.py    distances to the walls along rays, and the components of the observation
track.py    tracks, their files and rules; tracks/*.json are the shipped ones
gap.py      a scripted driver that follows the gap
picture.py  pictures of a track and of karts on it
"""
