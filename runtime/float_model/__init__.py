"""The float twin: a NIR graph computed in floating point, the reference of every compiled program.

It computes all of NIR, also what no chip can hold, and spikes (B, T, *N) of every layer come out.

graph            the network: order, delays, state, batches
neurons          neurons, and what a spike does to them
nodes            what each primitive of NIR computes
"""
