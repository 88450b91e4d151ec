"""Integrate-and-fire neurons without a synaptic current: TrueNorth, Speck, ODIN, tinyODIN, Spiker.

`neurons` is the specification; each datasheet says which of its rules the chip follows.

neurons          what chips differ in, and one timestep
spike_queue      one timestep of all layers, whose spikes go through a queue on the chip
arithmetic       the arithmetic of these chips: a layer in floats becomes integers
crossbars        TrueNorth (IBM, 2014), ODIN and tinyODIN (Frenkel et al. 2019)
layer_accelerators
                 Speck 2f (SynSense), Spiker+ (Politecnico di Torino)
traces           recorded runs of ODIN and tinyODIN, event by event, and of Spiker+
"""
