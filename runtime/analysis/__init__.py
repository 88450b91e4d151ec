"""Analysis: where a chip differs from the float twin, and why.

Everything here compares a program with the network in float.

activity     spikes and membranes of every layer of both, in float units; distances of spike trains
drift        size and cause of the difference by kind of rounding; dead or saturated layers
"""
