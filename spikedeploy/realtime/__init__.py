"""Real time: the closed loop at a fixed rate, and a policy that other programs ask for actions.

pacing      rate, deadline and duration as they are given; waiting for the next period
paced_loop  episodes at that rate, and how long each control step took
protocol    requests and replies of `serve`, as JSON
served_policy  the clients of `serve`, and the episode of each
server      its socket
"""
