"""Analysis: where a chip differs from the float twin, and why.

Everything here compares what a program does with what the network does in float.

activity         spikes and membranes of every layer in float units, of the twin and of a chip
drift            how far both are apart, and which kind of rounding causes it
spike_distance   distances of spike trains
readout_drift    membranes of readout layers, of a chip and of the twin
diagnosis        layers that never spike or nearly always do, the cause, and the first difference
calibration      scales and thresholds that are chosen on recorded inputs
"""
