"""Xylo's neurons: events added one by one, states that saturate, decays by shifts.

arithmetic       The arithmetic of chips that add up event by event, saturate at each, and deca
datasheets       Xylo-Audio 2 (SynSense SYNS61201): core version 2, in the reading of xylosim
layers           A network as Xylo has it, still in floats: populations, dashes, biases and tim
quantise         Quantisation for Xylo: 8-bit weights, and thresholds and biases that follow th
"""
