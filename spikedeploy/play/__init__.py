"""Windows: drive a kart, watch a policy, replay recorded episodes, draw a track.

An app draws itself as a surface, so that it can be tested, and filmed, without a window.

display  whether there is one, before anything is loaded
window   shows an app: events in, frames out, screenshots
theme    colours, fonts, bars, key caps, the picture of an environment
spikes   spikes of a policy on the observations of an episode, and their panel

drive    `spikedeploy play`: drivers, the session, its window
replay   `spikedeploy replay`: sources, time, the window, films
ghosts   the ghosts of a replay on their track
draw     `spikedeploy draw`: the window
draft    a track under construction, with undo, and its files
"""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
