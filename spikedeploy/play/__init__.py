"""`spikedeploy play`: drive a kart, command a robot or watch a policy, in a window.

display  whether there is a screen, before anything is loaded
session  drivers, and one of them in an environment, episode after episode
window   the window: keys in, frames out, screenshots
panel    colours, fonts, bars, the panel beside a picture
spikes   spikes of the policy that drives
"""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
