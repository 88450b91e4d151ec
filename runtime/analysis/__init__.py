"""Analysis: where a chip differs from the float twin, and why.

Everything here compares what a program does with what the network does in float.

activity     spikes and membranes of every layer in float units, of both; distances of spike trains
drift        how far both are apart, which kind of rounding causes it, and dead or saturated layers
calibration  scales and thresholds that are chosen on recorded inputs
"""
