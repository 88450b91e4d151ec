"""The codec: observations to spikes, and spikes to actions.

codec            The codec: observations to spikes, output to actions; NumPy float64 is the ref
population       Population coding: a number becomes the spikes of neurons with Gaussian recept
rate             Rate coding: a number becomes the spikes of one neuron, the more the larger it
xorshift         Random bytes as a chip makes them: one xorshift32 generator for each neuron of
"""
