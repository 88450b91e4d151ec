"""Dialects: the meaning of a NIR file in other tools.

NIR leaves dt, reset, integrator and delays open. Each tool fills them in on its own, ignores some
parameters, and may write others than it reads: Norse misreads its own files.

dialect          what is known of a tool, and the steps that tools share
tools            Lava, Nengo, Norse, Rockpool, sinabs, SpikingJelly; the tables of all tools
snntorch_import  snnTorch
reading          a file as a tool reads it, or as the tool that wrote it means it
rewriting        a network in the scaling that the import of a tool accepts
"""
