"""Windows and films: driving by hand, watching a policy, and replaying what was driven.

theme.py    colours, fonts, and the few shapes that every panel is made of
window.py   an app on the screen: events in, frames out; screenshots
keys.py     which keys drive which world
session.py  a drive: a world, who drives it, and the record
stage.py    the picture of a world
hud.py      the panel beside it
driving.py  `spikedeploy play`
source.py   what a replay reads: ghosts, batch after batch, or a recorded drive
playback.py the time of a replay: pause, speed, seek, batch after batch
reels.py    one batch of a replay: ghosts on a track, or a robot's walk
crowd.py    many ghosts at once
crowd_picture.py  them, drawn
overlay.py  several sources over one another
brain.py    what a spiking policy does at the leading ghost
rasters.py  its spikes, drawn
replaying.py `spikedeploy replay`
sketch.py   a track while it is drawn: what every click and key makes of it
sketch_file.py  tracks and drafts as files
drawing.py  `spikedeploy draw`
drawing_picture.py  a sketch and its panel, drawn
film.py     an app as MP4 or GIF
"""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
