"""Windows: drive a kart, watch a policy, replay recorded episodes, draw a track.

An app draws itself as a surface, so that it can be tested, and filmed, without a window.

display            whether there is one, before anything is loaded
window             shows an app: events in, frames out, screenshots
theme              colours, fonts, bars, key caps
env_picture        the picture of an environment

drive_app          `spikedeploy play`
driving_network    a spiking policy that drives, with its spikes and costs
session            one driver in one environment, episode after episode, recorded
drivers            a person at the keys, a policy, or a policy that a person commands
drive_panel        speed, gates, LIDAR and rewards beside a drive

replay_app         `spikedeploy replay`
replay_source      ghosts batch after batch, or one recorded rollout
replay_views       one batch: ghosts on a track, or a robot's episode again
overlay_view       several sources on one track
ghost_group        many ghosts: where each is at a step
ghost_picture      such a group, drawn
playback           pause, speed, seek, next batch
spike_recorder     spikes of a policy on recorded observations
spike_panel        these spikes, drawn
replay_film        a replay as MP4 or GIF

track_editor       `spikedeploy draw`
track_editor_view  a draft of a track and its panel, drawn
track_draft        a track under construction, with undo
draft_files        tracks and drafts as files
"""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
