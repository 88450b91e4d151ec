"""Integrate-and-fire neurons without a synaptic current: TrueNorth, Speck, ODIN, Spiker.

arithmetic       The arithmetic of chips that add spikes straight to the membrane, without a sy
odin             ODIN (Frenkel et al. 2019, 28 nm): 256 neurons, 8-bit membranes, event after e
quantise         Quantisation for chips without a synaptic current
speck2f          Speck 2f (SynSense, DYNAP-CNN family): integrate-and-fire neurons without a le
spiker           Spiker+ (Politecnico di Torino): a generator of accelerators for FPGAs, with f
truenorth        TrueNorth (IBM, 28 nm, 2014): binary crossbars, four types of axons, ticks of
update           One timestep of integrate-and-fire neurons in the arithmetic of a chip: its sp
"""
