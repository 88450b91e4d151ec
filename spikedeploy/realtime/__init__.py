"""Real time: the closed loop at a fixed rate, and a policy that other programs ask for actions.

pacing      rate, deadline and duration as they are given; waiting for the next period
paced_loop  episodes at that rate, and how long each control step took
protocol    requests and replies of `serve`, as JSON
client      what one client of `serve` has: its episode, and what a step cost
server      the socket, and the clients that it knows
"""
