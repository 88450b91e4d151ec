"""Our networks opened by other tools, run there on the same spikes, and compared.

No tool is imported here: each runs in a Python of its own, which `./spike test --peers` makes.

peer_process  what runs there; imports nothing of ours
cases         the tools; files as they are and as they are rewritten for one; every spike compared
page          the command, and its table
"""
