"""Xylo's neurons: events added one by one, states that saturate, decays by shifts.

`neurons` is the specification, equal to SynSense's simulator xylosim.

neurons          the registers, and one timestep
arithmetic       the arithmetic of Xylo, with its quantisation
layers           a network as Xylo has it, still in floats: populations, dashes, biases and time
datasheets       Xylo-Audio 2 and 3, and Xylo-IMU
xylosim_traces   recorded runs of Xylo, as xylosim's layers are built and recorded
"""
