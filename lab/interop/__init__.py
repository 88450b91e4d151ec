"""Our networks opened by other tools, run there on the same spikes, and compared.

No tool is imported here: each runs in a Python of its own, which `./spike test --peers` makes.

peers         the tools, their Pythons, their versions
peer_process  what runs there; imports nothing of ours
cases         a file as it is and as it is rewritten for a tool, with the spikes it should have
outcome       what came of a case: opens, refuses, spikes equal, or the first difference
measured      all cases of all files, resumed where they stopped
page          the table
"""
