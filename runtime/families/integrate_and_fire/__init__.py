"""Integrate-and-fire neurons without a synaptic current: TrueNorth, Speck, ODIN, Spiker.

`neurons` is the specification; each datasheet says which of its rules the chip follows.

neurons          the rules, and one timestep
arithmetic       the arithmetic of these chips
quantise         a layer in floats becomes integers; what weights and neurons must keep to
truenorth        TrueNorth (IBM, 28 nm, 2014)
speck2f          Speck 2f (SynSense)
odin             ODIN (Frenkel et al. 2019, 28 nm)
spiker           Spiker+ (Politecnico di Torino), on FPGAs
"""
