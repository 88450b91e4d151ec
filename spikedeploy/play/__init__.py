"""`spikedeploy play`: drive a kart, command a robot or watch a policy, in a window.

display    whether there is a screen, before anything is loaded
session    drivers, and one of them in an environment, episode after episode
drive_app  the window: keys in, frames out, numbers beside the picture
"""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
