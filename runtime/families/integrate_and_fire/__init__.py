"""Integrate-and-fire neurons without a synaptic current: TrueNorth, Speck, ODIN, tinyODIN, Spiker.

`neurons` is the specification; a datasheet says which of its rules a chip follows.

neurons          what chips differ in, and one timestep
spike_queue      one timestep of all layers, whose spikes go through a queue on the chip
event_queues     Speck event by event: each layer works on a queue of its own
event_machine    a running Speck that is sent one event after another
arithmetic       the arithmetic of these chips: a layer in floats becomes integers
numba_steps      the compiled step and backend in timesteps; numba_events event by event
"""
