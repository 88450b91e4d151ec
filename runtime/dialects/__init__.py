"""Dialects: the meaning of a NIR file in other tools, one file for each tool.

NIR leaves dt, reset, integrator and delays open. Each tool fills them in on its own, ignores some
parameters, and may write other ones than it reads: Norse misreads its own files.

dialect          the tables of tools, and the steps that all of them share
rewriting        a network in the scaling that the import of a tool accepts
lava, nengo, norse, rockpool, sinabs, snntorch, spikingjelly
"""
