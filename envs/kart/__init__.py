"""The karts: tracks, LIDAR, rewards, three worlds and a scripted driver.

corridor         Random corridors: a new track of square cells at every reset
ends             When a kart has given up: one rule of ours, and kart-simulator's two
env              What the karts have in common: the world, the episode, the observation and the
gap              A scripted driver: follow the gap in the LIDAR's scan (the idea of Sezer and G
gazebo           KartGazebo-v0: a kart that drives or turns, at one speed each, like a wheeled
grid             KartGrid-v0: a kart without a heading, pushed up, down, left and right
lidar            A LIDAR: how far it is to the walls along rays, all of them in one computation
observation      What a kart observes: named components, each in [-1, 1]
options          What the karts' options stand for, and which of them are refused
picture          Pictures of a kart on its track; what `render` gives, and what windows and fil
reward           What a kart is paid for in one step: named terms whose sum is the reward
scene            A track on a surface of some size: where its points are, and the ground that n
steer            KartSteer-v0: a kart with throttle, brake and steering, which never slides
track            Tracks: walls, gates in order, and a place to start; tracks/*.json hold those
track_rules      What makes a track one that a kart can drive: checked once, when its file is r
world            The physics of one kart on one track: a circle among lines that are felt but s
"""
