"""Integrate-and-fire neurons without a synaptic current: TrueNorth, Speck, ODIN, Spiker.

`neurons` is the specification; each datasheet says which of its rules the chip follows.

neurons          the rules, and one timestep
arithmetic       the arithmetic of these chips
quantise         a layer in floats becomes integers; what weights and neurons must keep to
crossbars        TrueNorth (IBM, 2014), ODIN (Frenkel et al. 2019)
layer_accelerators
                 Speck 2f (SynSense), Spiker+ (Politecnico di Torino)
"""
