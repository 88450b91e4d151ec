"""The hexapod: a walking robot on MuJoCo, with and without velocity commands.

command          HexapodCommand-v0: follow a commanded forward speed and turn rate over rougher
disturbances     What differs from one episode to the next: the body's parameters and the pushe
env              Hexapod-v0: walk straight ahead over rough ground
gait             The central pattern generator: a tripod gait of six phase-locked sines
reward           What the hexapod is paid for in one control step: named terms whose sum is the
robot            The hexapod itself: its MuJoCo model, its servos and what can be sensed of it
terrain          Rough ground: a height field of random bumps, made anew for every episode
"""
