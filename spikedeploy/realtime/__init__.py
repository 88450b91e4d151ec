"""Real time: the closed loop at a fixed rate, and a policy that answers other programs.

paced_loop  rate, deadline and duration; episodes at that rate, and the time of each control step
server      requests of `serve`, its clients, and its socket
"""
