"""The float twin: a NIR graph computed in floating point, the reference of every compiled program.

It computes all of NIR, also what no chip can hold, and spikes (B, T, *N) of every layer come out.

graph            the network: order, delays, state, batches
nodes            what each primitive of NIR computes
"""
