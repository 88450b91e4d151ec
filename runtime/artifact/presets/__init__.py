"""Presets: how other tools read the same file.

Each translates a graph into one with the tool's meaning under a stated convention; PRESETS is where
a new one is entered.

preset           the table, the class, and the steps that the tools' files are built from
nir_paper        Lava and Nengo, by the NIR paper's imports
torch_tools      Norse, snnTorch, SpikingJelly
synsense         Rockpool, sinabs
"""
