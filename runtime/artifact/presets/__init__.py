"""Presets: what other tools make of the same file; a tool, a file.

lava             What Lava's processes make of a NIR file, as the NIR paper's import sets them
nengo            What the NIR paper's import for Nengo makes of a NIR file; the package itself
nodes            Pieces of presets: nodes with other parameters, and demands that tools make on
norse            What Norse's import makes of a NIR file
preset           Presets: what other tools make of the same file
rockpool         What Rockpool's import makes of a NIR file
sinabs           What sinabs' import makes of a NIR file
snntorch         What snnTorch's import makes of a NIR file
spikingjelly     What SpikingJelly's import makes of a NIR file
"""
