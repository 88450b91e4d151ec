"""Presets: how other tools read the same file, a tool a file.

Each translates a graph into one with the tool's meaning under a stated convention; PRESETS is where
a new one is entered.

preset           the table, the class, and the steps that the tools' files are built from
lava             Lava, as the NIR paper's import configures it
nengo            Nengo, by the NIR paper's import
norse            Norse
rockpool         Rockpool
sinabs           sinabs
snntorch         snnTorch
spikingjelly     SpikingJelly
"""
