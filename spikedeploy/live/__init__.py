"""`run --watch`: episodes in browsers of this machine while they are played.

steps         what is told of an episode: its beginning, control steps, its end
backlog       what a browser is yet to be told, and the browsers that listen
server        the page and its events, over HTTP on 127.0.0.1
view          both together: what the loop hands its control steps to
watched_loop  the paced loop that does, and which loop a run plays in
"""
