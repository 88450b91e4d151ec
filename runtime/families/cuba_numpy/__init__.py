"""The NumPy kernels of CuBa-LIF neurons, equal to the interpreter bit for bit.

layer_kernel     The kernels: a layer's whole window of timesteps in few NumPy calls, equal to
neuron_update    Advancing: the neurons of a layer from timestep to timestep, in few NumPy call
pipeline         The pipeline: every layer's window, one after another, with the spikes that go
sums             Synapses in a hurry: from spikes to the sum of weights that arrives, in three
wave             The wave: small layers one behind the other, advanced together in one stack
ways             What the ways of summing weights cost on this machine, measured when a network
"""
