"""The NumPy kernels of CuBa-LIF neurons.

Equal to the interpreter bit for bit on chips with integers; on `ideal` up to float64 rounding.

event_counter    the events of a window
layer_kernel     a layer's whole window of timesteps in few NumPy calls
neuron_update    the neurons of a layer from timestep to timestep
pipeline         the backend: every layer's window, one after another
raster           spikes of one source with their counts; aligned memory
sums             from spikes to the sum of weights that arrives, in three ways
wave             small layers one after another, advanced together in one stack
"""
